// SPDX-License-Identifier: Apache-2.0
// What every tracker asks of its input.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_INPUT_CHECK_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_INPUT_CHECK_H_

#include <opencv2/core/mat.hpp>

#include "absl/status/status.h"
#include "map_store/geometry/box.h"

namespace groundlock::target::internal {

// kInvalidArgument unless the image is CV_8UC3 or CV_8UC1 and has pixels.
absl::Status CheckImage(const cv::Mat& image);
// kInvalidArgument unless the box is usable and touches the image.
absl::Status CheckStartBox(const cv::Mat& image, const geometry::Box2& box_px);
// Finite, of positive size, and within what double precision can address.
bool IsUsable(const geometry::Box2& box_px);
// Whether some of the box lies in the image.
bool Touches(const cv::Mat& image, const geometry::Box2& box_px);

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_INPUT_CHECK_H_
