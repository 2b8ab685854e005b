// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/lane_transform.h"

#include <gtest/gtest.h>

#include <complex>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "server/target/internal/plane_transform.h"

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;
constexpr int kGroup = LaneTransform::kCellFloats;

std::vector<float> RandomCells(int count) {
  std::mt19937 generator(1);
  std::normal_distribution<float> normal;
  std::vector<float> cells(static_cast<std::size_t>(count) * kGroup);
  for (float& value : cells) value = normal(generator);
  return cells;
}

cv::Mat Lane(const float* cells, int pitch, int size, int lane) {
  cv::Mat line(1, size, CV_32FC2);
  auto* value = line.ptr<std::complex<float>>();
  for (int i = 0; i < size; ++i) {
    value[i] = {cells[i * pitch + lane], cells[i * pitch + kLanes + lane]};
  }
  return line;
}

class LaneTransformTest : public ::testing::TestWithParam<int> {};

// Single precision: a sum of `size` values of magnitude 1 is off by about 1e-7
// sqrt(size) log(size); 1e-5 relative to the largest leaves room.
TEST_P(LaneTransformTest, EveryLaneIsTheFourierTransform) {
  const int size = GetParam();
  constexpr int kApart = 3 * kGroup;  // cells of the line
  const std::vector<float> cells = RandomCells(3 * size);
  std::vector<float> transformed(static_cast<std::size_t>(size) * kGroup);
  LaneTransform transform(size);
  transform.Forward(&cells[kGroup], kApart, transformed.data(), kGroup);
  for (int lane = 0; lane < kLanes; ++lane) {
    cv::Mat expected;
    cv::dft(Lane(&cells[kGroup], kApart, size, lane), expected);
    EXPECT_LT(cv::norm(Lane(transformed.data(), kGroup, size, lane),
                       expected,
                       cv::NORM_INF),
              1e-5 * cv::norm(expected, cv::NORM_INF))
        << "lane " << lane;
  }
}

TEST_P(LaneTransformTest, InverseUndoesForwardInPlace) {
  const int size = GetParam();
  std::vector<float> cells = RandomCells(size);
  const std::vector<float> before = cells;
  LaneTransform transform(size);
  transform.Forward(cells.data(), kGroup, cells.data(), kGroup);
  transform.Inverse(cells.data(), kGroup, cells.data(), kGroup);
  for (int i = 0; i < size * kGroup; ++i) {
    ASSERT_NEAR(cells[i] / static_cast<float>(size), before[i], 1e-5) << i;
  }
}

TEST_P(LaneTransformTest, APlaneComesBackFromHalfItsSpectrum) {
  const int size = GetParam();
  cv::Mat plane(size, size, CV_32F);
  cv::theRNG().state = 1;
  cv::randn(plane, 0.0, 1.0);
  cv::Mat spectrum;
  cv::dft(plane, spectrum, cv::DFT_COMPLEX_OUTPUT);
  PlaneTransform transform(size);
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x <= size / 2; ++x) {
      transform.Put(x, y, spectrum.at<std::complex<float>>(y, x));
    }
  }
  cv::Mat found(size, size, CV_32F);
  transform.Inverse(1.0F / static_cast<float>(size * size), found.ptr<float>());
  EXPECT_LT(cv::norm(found, plane, cv::NORM_INF), 1e-5);
}

INSTANTIATE_TEST_SUITE_P(Sizes,
                         LaneTransformTest,
                         ::testing::Values(6, 8, 9, 12, 24, 32, 48, 54));

}  // namespace
}  // namespace groundlock::target::internal
