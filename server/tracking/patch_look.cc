// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/patch_look.h"

#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>

#include "server/image/frame.h"
#include "server/image/luma_pyramid.h"

namespace groundlock::tracking {

cv::Mat PatchAround(const cv::Mat& luma, const Eigen::Vector2d& p_px) {
  cv::Mat patch;
  cv::getRectSubPix(
      luma,
      cv::Size(image::LumaPyramid::kWindowPx, image::LumaPyramid::kWindowPx),
      cv::Point2d(p_px.x() - image::kPixelCenter,
                  p_px.y() - image::kPixelCenter),
      patch);
  return patch;
}

double CorrelationOf(const cv::Mat& a, const cv::Mat& b) {
  double n = 0.0, sa = 0.0, sb = 0.0, saa = 0.0, sbb = 0.0, sab = 0.0;
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      const double u = a.at<std::uint8_t>(y, x);
      const double v = b.at<std::uint8_t>(y, x);
      n += 1.0;
      sa += u;
      sb += v;
      saa += u * u;
      sbb += v * v;
      sab += u * v;
    }
  }
  const double variances = (saa - sa * sa / n) * (sbb - sb * sb / n);
  return variances > 0.0 ? (sab - sa * sb / n) / std::sqrt(variances) : 0.0;
}

}  // namespace groundlock::tracking
