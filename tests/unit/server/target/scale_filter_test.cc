// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/scale_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace groundlock::target::internal {
namespace {

using geometry::Box2;

constexpr double kCenter = 150.0;

cv::Mat Texture() {
  cv::Mat noise(300, 300, CV_8UC3);
  cv::RNG rng(1);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 256);
  cv::Mat smooth;
  cv::GaussianBlur(noise, smooth, {}, 3.0);
  cv::normalize(smooth, smooth, 0, 255, cv::NORM_MINMAX);
  return smooth;
}

cv::Mat Zoomed(const cv::Mat& image, double factor) {
  // About the continuous pixel kCenter, which is index kCenter - 0.5.
  const double offset = (kCenter - 0.5) * (1.0 - factor);
  cv::Mat zoomed;
  cv::warpAffine(image,
                 zoomed,
                 cv::Matx23d(factor, 0, offset, 0, factor, offset),
                 image.size(),
                 cv::INTER_CUBIC,
                 cv::BORDER_REPLICATE);
  return zoomed;
}

Box2 Box(double side_px) {
  return Box2::FromCenter({kCenter, kCenter}, {side_px, 0.7 * side_px});
}

// Half a step of 1.02: the interpolation between the scales must beat picking
// one.
TEST(ScaleFilter, MeasuresAZoom) {
  const cv::Mat image = Texture();
  ScaleFilter filter(kFineSteps);
  filter.Train(image, Box(60));
  for (const double factor : {0.95, 0.97, 0.98, 0.99, 1.0, 1.01, 1.03, 1.05}) {
    EXPECT_NEAR(filter.Estimate(Zoomed(image, factor), Box(60)), factor, 0.01);
  }
}

TEST(ScaleFilter, CoarseStepsMeasureAQuickZoom) {
  const cv::Mat image = Texture();
  ScaleFilter filter(kCoarseSteps);
  filter.Train(image, Box(60));
  for (const double factor : {0.9, 0.94, 0.98, 1.0, 1.02, 1.06, 1.1}) {
    EXPECT_NEAR(filter.Estimate(Zoomed(image, factor), Box(60)), factor, 0.02);
  }
}

TEST(ScaleFilter, FollowsALongZoom) {
  const cv::Mat image = Texture();
  ScaleFilter filter(kFineSteps);
  double side = 40.0;
  filter.Train(image, Box(side));
  double factor = 1.0;
  for (int i = 0; i < 50; ++i) {
    factor *= 1.015;
    const cv::Mat zoomed = Zoomed(image, factor);
    side *= filter.Estimate(zoomed, Box(side));
    filter.Update(zoomed, Box(side));
  }
  // 2.1 times larger; 5 % is a hundredth of a step's error a frame, piled up.
  EXPECT_NEAR(side / 40.0 / factor, 1.0, 0.05);
}

TEST(ScaleFilter, AFlatImageSaysNothing) {
  const cv::Mat flat(300, 300, CV_8UC1, cv::Scalar(90));
  ScaleFilter filter(kFineSteps);
  filter.Train(flat, Box(50));
  EXPECT_NEAR(filter.Estimate(flat, Box(50)), 1.0, 1e-9);
}

}  // namespace
}  // namespace groundlock::target::internal
