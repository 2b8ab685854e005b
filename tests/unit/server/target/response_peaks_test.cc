// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/response_peaks.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

constexpr int kCells = 48;

// A bump of the given height about cell (x, y), which may be negative.
void AddBump(double height, int x, int y, cv::Mat& response) {
  for (int dy = -3; dy <= 3; ++dy) {
    for (int dx = -3; dx <= 3; ++dx) {
      response.at<float>((y + dy + kCells) % kCells,
                         (x + dx + kCells) % kCells) +=
          static_cast<float>(height * std::exp(-0.5 * (dx * dx + dy * dy)));
    }
  }
}

cv::Mat TwoBumps() {
  cv::Mat response = cv::Mat::zeros(kCells, kCells, CV_32F);
  AddBump(1.0, 12, 0, response);
  AddBump(0.8, -10, -1, response);
  return response;
}

PeakExpectation At(double x_px, double y_px, double sigma_px) {
  return {.offset_px = -Eigen::Vector2d(x_px, y_px),
          .information = Eigen::Matrix2d::Identity() / (sigma_px * sigma_px),
          .cell_px = Eigen::Vector2d(2.0, 2.0),
          .target_cells = Eigen::Vector2d(8.0, 8.0)};
}

TEST(ResponsePeaks, TheHighestWinsWhereItIsNoSurprise) {
  const Peak peak = FindExpectedPeak(TwoBumps(), At(20.0, 0.0, 10.0));
  EXPECT_NEAR(peak.shift_cells.x(), 12.0, 0.1);
  EXPECT_NEAR(peak.value, 1.0, 1e-6);
}

TEST(ResponsePeaks, ARivalWinsWhereTheTargetIsExpected) {
  const Peak peak = FindExpectedPeak(TwoBumps(), At(-20.0, -2.0, 5.0));
  EXPECT_EQ(peak.shift_cells, Eigen::Vector2d(-10.0, -1.0));
  EXPECT_NEAR(peak.value, 0.8, 1e-6);
}

TEST(ResponsePeaks, WhatIsTooLowIsNoRival) {
  cv::Mat response = cv::Mat::zeros(kCells, kCells, CV_32F);
  AddBump(1.0, 12, 0, response);
  AddBump(0.6, -10, -1, response);
  const Peak peak = FindExpectedPeak(response, At(-20.0, -2.0, 5.0));
  EXPECT_NEAR(peak.shift_cells.x(), 12.0, 0.1);
}

TEST(ResponsePeaks, ALonelyPeakIsSharp) {
  cv::Mat one = cv::Mat::zeros(kCells, kCells, CV_32F);
  one.at<float>(3, 5) = 2.0F;
  // All of the energy is in one of the cells.
  EXPECT_NEAR(PeakToEnergy(one), kCells * kCells, 1e-6);
  EXPECT_LT(PeakToEnergy(TwoBumps()), 0.5 * PeakToEnergy(one));
  EXPECT_EQ(PeakToEnergy(cv::Mat::zeros(kCells, kCells, CV_32F)), 0.0);
}

TEST(ResponsePeaks, WhatIsNearAPeakIsNoSidelobe) {
  cv::Mat response(kCells, kCells, CV_32F);
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      response.at<float>(y, x) = (x + y) % 2 == 0 ? 0.1F : -0.1F;
    }
  }
  // The rest is +-0.1, as often up as down but for one cell.
  const double before = PeakToSidelobe(response, {{0.0, 0.0}, 1.0});
  EXPECT_NEAR(before, 10.0, 0.01);
  AddBump(5.0, 0, 0, response);
  EXPECT_NEAR(PeakToSidelobe(response, {{0.0, 0.0}, 1.0}), before, 1e-6);
  AddBump(5.0, 20, 20, response);
  EXPECT_LT(PeakToSidelobe(response, {{0.0, 0.0}, 1.0}), 0.5 * before);
}

}  // namespace
}  // namespace groundlock::target::internal
