// SPDX-License-Identifier: Apache-2.0
#include "server/image/ycc_to_bgr.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

namespace groundlock::image {
namespace {

cv::Mat Noise(cv::Size size, std::uint64_t seed) {
  cv::Mat noise(size, CV_8UC1);
  cv::RNG random(seed);
  random.fill(noise, cv::RNG::UNIFORM, 0, 256);
  return noise;
}

// Linear between the samples' centres.
double ChromaAt(const ChromaSamples& chroma, int x, int y) {
  const auto along = [](int at, int share, int count, int& first, int& second) {
    const double place = (at + 0.5) / share - 0.5;
    const int below = static_cast<int>(std::floor(place));
    first = std::clamp(below, 0, count - 1);
    second = std::clamp(below + 1, 0, count - 1);
    return place - below;
  };
  int left, right, top, bottom;
  const double u = along(
      chroma.origin_px.x + x, chroma.share_x, chroma.samples.cols, left, right);
  const double v = along(
      chroma.origin_px.y + y, chroma.share_y, chroma.samples.rows, top, bottom);
  const auto at = [&](int row, int column) {
    return static_cast<double>(chroma.samples.at<unsigned char>(row, column));
  };
  return (1.0 - v) * ((1.0 - u) * at(top, left) + u * at(top, right)) +
         v * ((1.0 - u) * at(bottom, left) + u * at(bottom, right));
}

TEST(YccToBgr, IsTheStandardsToOneLevelWhateverIsShared) {
  for (const int share_x : {1, 2}) {
    for (const int share_y : {1, 2}) {
      for (const cv::Size size : {cv::Size(1, 1),
                                  cv::Size(15, 7),
                                  cv::Size(16, 3),
                                  cv::Size(53, 10)}) {
        for (const cv::Point origin : {cv::Point(0, 0), cv::Point(3, 1)}) {
          const cv::Size count((origin.x + size.width) / share_x + 1,
                               (origin.y + size.height) / share_y + 1);
          const cv::Mat luma = Noise(size, 1);
          const ChromaSamples cb{Noise(count, 2), share_x, share_y, origin};
          const ChromaSamples cr{Noise(count, 3), share_x, share_y, origin};
          // Pixels around are nobody's to write.
          cv::Mat around(size.height + 2, size.width + 2, CV_8UC3);
          around.setTo(cv::Scalar::all(77));
          cv::Mat bgr = around(cv::Rect(cv::Point(1, 1), size));
          YccToBgr(luma, cb, cr, bgr);
          for (int y = 0; y < size.height; ++y) {
            for (int x = 0; x < size.width; ++x) {
              const double value = luma.at<unsigned char>(y, x);
              const double blue = std::round(ChromaAt(cb, x, y)) - 128.0;
              const double red = std::round(ChromaAt(cr, x, y)) - 128.0;
              const double expected[] = {
                  value + 1.772 * blue,
                  value - 0.344136 * blue - 0.714136 * red,
                  value + 1.402 * red};
              for (int i = 0; i < 3; ++i) {
                // One of the chroma's rounding, one of the sum's.
                ASSERT_NEAR(bgr.at<cv::Vec3b>(y, x)[i],
                            std::clamp(expected[i], 0.0, 255.0),
                            2.3)
                    << share_x << share_y << size << " at " << x << "," << y;
              }
            }
          }
          bgr.setTo(cv::Scalar::all(77));
          EXPECT_EQ(cv::countNonZero(around.reshape(1) != 77), 0);
        }
      }
    }
  }
}

// Without chroma to interpolate there is but one rounding.
TEST(YccToBgr, EveryColourIsExactToOneLevel) {
  cv::Mat luma(1, 256, CV_8UC1);
  for (int y = 0; y < 256; ++y) luma.at<unsigned char>(y) = y;
  cv::Mat bgr(1, 256, CV_8UC3);
  for (int blue = 0; blue < 256; blue += 5) {
    for (int red = 0; red < 256; red += 3) {
      YccToBgr(luma,
               {cv::Mat(1, 256, CV_8UC1, cv::Scalar(blue)), 1, 1, {}},
               {cv::Mat(1, 256, CV_8UC1, cv::Scalar(red)), 1, 1, {}},
               bgr);
      for (int y = 0; y < 256; ++y) {
        const double expected[] = {
            y + 1.772 * (blue - 128),
            y - 0.344136 * (blue - 128) - 0.714136 * (red - 128),
            y + 1.402 * (red - 128)};
        for (int i = 0; i < 3; ++i) {
          ASSERT_NEAR(bgr.at<cv::Vec3b>(0, y)[i],
                      std::clamp(std::round(expected[i]), 0.0, 255.0),
                      1.0);
        }
      }
    }
  }
}

}  // namespace
}  // namespace groundlock::image
