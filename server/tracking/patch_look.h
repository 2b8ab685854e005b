// SPDX-License-Identifier: Apache-2.0
// What a small patch of an image looks like, and another.
#ifndef GROUNDLOCK_SERVER_TRACKING_PATCH_LOOK_H_
#define GROUNDLOCK_SERVER_TRACKING_PATCH_LOOK_H_

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

namespace groundlock::tracking {

// The patch of LumaPyramid::kWindowPx pixels a side around `p_px`, which are
// pixels of `luma` (CV_8UC1), whose first one's centre is (0.5, 0.5); beyond
// the border its pixels go on. Thread-safe.
cv::Mat PatchAround(const cv::Mat& luma, const Eigen::Vector2d& p_px);

// Of two patches of the same size, CV_8UC1: in [-1, 1]; 0 if either has no
// texture. Thread-safe.
double CorrelationOf(const cv::Mat& a, const cv::Mat& b);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_PATCH_LOOK_H_
