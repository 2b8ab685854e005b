// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/spectrum.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

cv::Mat GaussianAt(int size, double x, double y, double sigma) {
  cv::Mat result(size, size, CV_32F);
  for (int r = 0; r < size; ++r) {
    for (int c = 0; c < size; ++c) {
      const double dx = std::remainder(c - x, size);
      const double dy = std::remainder(r - y, size);
      result.at<float>(r, c) = static_cast<float>(
          std::exp(-0.5 * (dx * dx + dy * dy) / (sigma * sigma)));
    }
  }
  return result;
}

TEST(Spectrum, RoundTrip) {
  cv::Mat image(32, 32, CV_32F);
  cv::RNG rng(7);
  rng.fill(image, cv::RNG::UNIFORM, -1.0, 1.0);
  cv::Mat spectrum;
  cv::Mat back;
  ForwardTransform(image, spectrum);
  InverseTransform(spectrum, back);
  EXPECT_LT(cv::norm(image, back, cv::NORM_INF), 1e-5);
}

// Correlation with a moved copy peaks at the movement.
TEST(Spectrum, CorrelationFindsTheShift) {
  const cv::Mat moved = GaussianAt(32, 5, 29, 1.5);
  cv::Mat a;
  cv::Mat b;
  ForwardTransform(moved, a);
  ForwardTransform(PeriodicGaussian(32, 1.5), b);
  cv::Mat product = cv::Mat::zeros(32, 32, CV_32FC2);
  AddConjugateProduct(a, b, product);
  cv::Mat correlation;
  InverseTransform(product, correlation);
  const Peak peak = FindPeak(correlation);
  EXPECT_NEAR(peak.shift_cells.x(), 5.0, 1e-3);
  EXPECT_NEAR(peak.shift_cells.y(), -3.0, 1e-3);
}

// A parabola through three samples of a Gaussian of 4 cells is off by less than
// 0.005 cells: its fourth-order term is (1/4)^2 of the second.
TEST(FindPeak, LiesBetweenTheCells) {
  for (const double at : {0.0, 0.25, -0.4, 7.3, -63.9, 63.2}) {
    const Peak peak = FindPeak(GaussianAt(128, at, -at, 4.0));
    EXPECT_NEAR(std::remainder(peak.shift_cells.x() - at, 128), 0.0, 0.005);
    EXPECT_NEAR(std::remainder(peak.shift_cells.y() + at, 128), 0.0, 0.005);
  }
}

TEST(FindPeak, FlatResponseIsNoShift) {
  const Peak peak = FindPeak(cv::Mat(16, 16, CV_32F, cv::Scalar(0.5)));
  EXPECT_EQ(peak.value, 0.5);
  EXPECT_TRUE(peak.shift_cells.isZero(0.0));
}

TEST(HannWindow, IsZeroAtTheEndsAndSymmetric) {
  const std::vector<float> window = HannWindow(9);
  EXPECT_NEAR(window.front(), 0.0, 1e-6);
  EXPECT_NEAR(window.back(), 0.0, 1e-6);
  EXPECT_NEAR(window[4], 1.0, 1e-6);
  EXPECT_NEAR(window[2], window[6], 1e-6);
  EXPECT_NEAR(window[2], 0.5, 1e-6);
}

}  // namespace
}  // namespace groundlock::target::internal
