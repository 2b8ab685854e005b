// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/open_cv_setup.h"

#include <opencv2/core/utility.hpp>

namespace groundlock::features {

void SetUpOpenCv() {
  cv::setNumThreads(1);
  cv::setUseOptimized(false);
}

}  // namespace groundlock::features
