// SPDX-License-Identifier: Apache-2.0
// A frame's luma, halved again and again.
#ifndef GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_
#define GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_

#include <memory>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace groundlock::image {

// Immutable; the first level shares the image's pixels by reference count.
struct LumaPyramid {
  // Side of the patches that are followed in it, and its levels above the image
  // itself.
  static constexpr int kWindowPx = 13;
  static constexpr int kMaxLevel = 5;

  // CV_8UC1, each within a border of kWindowPx pixels that mirrors it. A pixel
  // is the mean of four of the level before, so that pixel coordinates, with
  // the first one's centre at (0.5, 0.5), are halved too.
  std::vector<cv::Mat> levels;
  cv::Size size_px;
};

// Of a CV_8UC1 image, which the first level shares if it lies within a border
// of kWindowPx (as that of a decoded JPEG does), and copies if not.
std::shared_ptr<const LumaPyramid> BuildPyramid(const cv::Mat& luma);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_
