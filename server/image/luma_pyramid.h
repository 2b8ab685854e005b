// SPDX-License-Identifier: Apache-2.0
// A frame's image pyramid in the form that Lucas-Kanade takes.
#ifndef GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_
#define GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_

#include <memory>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace groundlock::image {

// Immutable; levels share pixels by reference count.
struct LumaPyramid {
  // Side of the largest window that may be followed in it, and its levels
  // above the image itself.
  static constexpr int kWindowPx = 13;
  static constexpr int kMaxLevel = 5;

  // As cv::buildOpticalFlowPyramid makes them: a level, or a level and its
  // derivatives, by turns.
  std::vector<cv::Mat> levels;
  bool has_derivatives = false;
  cv::Size size_px;
};

// Of a CV_8UC1 image, which the first level shares if it lies within a border
// of kWindowPx (as that of a decoded JPEG does), and copies if not.
std::shared_ptr<const LumaPyramid> BuildPyramid(const cv::Mat& luma);

// The same levels with their derivatives: what a frame needs from which
// landmarks are followed into many others.
std::shared_ptr<const LumaPyramid> WithDerivatives(
    std::shared_ptr<const LumaPyramid> pyramid);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_LUMA_PYRAMID_H_
