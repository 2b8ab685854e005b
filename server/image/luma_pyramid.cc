// SPDX-License-Identifier: Apache-2.0
#include "server/image/luma_pyramid.h"

#include <opencv2/video/tracking.hpp>

namespace groundlock::image {

std::shared_ptr<const LumaPyramid> BuildPyramid(const cv::Mat& luma) {
  auto pyramid = std::make_shared<LumaPyramid>();
  pyramid->size_px = luma.size();
  cv::buildOpticalFlowPyramid(
      luma,
      pyramid->levels,
      cv::Size(LumaPyramid::kWindowPx, LumaPyramid::kWindowPx),
      LumaPyramid::kMaxLevel,
      /*withDerivatives=*/false,
      cv::BORDER_REFLECT_101,
      cv::BORDER_CONSTANT,
      /*tryReuseInputImage=*/true);
  return pyramid;
}

std::shared_ptr<const LumaPyramid> WithDerivatives(
    std::shared_ptr<const LumaPyramid> pyramid) {
  if (pyramid->has_derivatives) return pyramid;
  auto derived = std::make_shared<LumaPyramid>();
  derived->size_px = pyramid->size_px;
  derived->has_derivatives = true;
  for (const cv::Mat& level : pyramid->levels) {
    // A level lies within the border it needs; as a part of that, OpenCV takes
    // it as it is.
    constexpr int kBorderPx = LumaPyramid::kWindowPx;
    cv::Mat bordered = level;
    bordered.adjustROI(kBorderPx, kBorderPx, kBorderPx, kBorderPx);
    std::vector<cv::Mat> one;
    cv::buildOpticalFlowPyramid(
        bordered(cv::Rect(kBorderPx, kBorderPx, level.cols, level.rows)),
        one,
        cv::Size(LumaPyramid::kWindowPx, LumaPyramid::kWindowPx),
        /*maxLevel=*/0,
        /*withDerivatives=*/true,
        cv::BORDER_REFLECT_101,
        cv::BORDER_CONSTANT,
        /*tryReuseInputImage=*/true);
    derived->levels.insert(derived->levels.end(), one.begin(), one.end());
  }
  return derived;
}

}  // namespace groundlock::image
