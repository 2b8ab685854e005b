// SPDX-License-Identifier: Apache-2.0
#include "server/image/luma_pyramid.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace groundlock::image {
namespace {

constexpr int kBorderPx = LumaPyramid::kWindowPx;

// Room for a level of that size within its border.
cv::Mat MakeLevel(cv::Size size_px) {
  const cv::Mat bordered(
      size_px.height + 2 * kBorderPx, size_px.width + 2 * kBorderPx, CV_8UC1);
  return bordered(cv::Rect(cv::Point(kBorderPx, kBorderPx), size_px));
}

void FillBorder(const cv::Mat& level) {
  cv::Mat bordered = level;
  bordered.adjustROI(kBorderPx, kBorderPx, kBorderPx, kBorderPx);
  // In place.
  cv::copyMakeBorder(level,
                     bordered,
                     kBorderPx,
                     kBorderPx,
                     kBorderPx,
                     kBorderPx,
                     cv::BORDER_REFLECT_101 | cv::BORDER_ISOLATED);
}

bool IsWithinBorder(const cv::Mat& luma) {
  cv::Size whole;
  cv::Point offset;
  luma.locateROI(whole, offset);
  return std::min(offset.x, offset.y) >= kBorderPx &&
         offset.x + luma.cols + kBorderPx <= whole.width &&
         offset.y + luma.rows + kBorderPx <= whole.height;
}

}  // namespace

std::shared_ptr<const LumaPyramid> BuildPyramid(const cv::Mat& luma) {
  auto pyramid = std::make_shared<LumaPyramid>();
  pyramid->size_px = luma.size();
  cv::Mat level = luma;
  if (!IsWithinBorder(luma)) {
    level = MakeLevel(luma.size());
    luma.copyTo(level);
    FillBorder(level);
  }
  pyramid->levels.push_back(level);
  for (int i = 1; i <= LumaPyramid::kMaxLevel; ++i) {
    const cv::Size halved_px(level.cols / 2, level.rows / 2);
    if (std::min(halved_px.width, halved_px.height) <= LumaPyramid::kWindowPx) {
      break;
    }
    cv::Mat halved = MakeLevel(halved_px);
    cv::resize(level(cv::Rect(cv::Point(), halved_px * 2)),
               halved,
               halved_px,
               0.0,
               0.0,
               cv::INTER_AREA);
    FillBorder(halved);
    pyramid->levels.push_back(halved);
    level = halved;
  }
  return pyramid;
}

}  // namespace groundlock::image
