// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/lane_transform.h"

#include <gtest/gtest.h>

#include <complex>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;
constexpr int kGroup = LaneTransform::kCellFloats;

std::vector<float> RandomCells(int size) {
  std::mt19937 generator(1);
  std::normal_distribution<float> normal;
  std::vector<float> cells(static_cast<std::size_t>(size) * size * kGroup);
  for (float& value : cells) value = normal(generator);
  return cells;
}

cv::Mat Lane(const std::vector<float>& cells, int size, int lane) {
  cv::Mat plane(size, size, CV_32FC2);
  auto* value = plane.ptr<std::complex<float>>();
  for (int i = 0; i < size * size; ++i) {
    value[i] = {cells[i * kGroup + lane], cells[i * kGroup + kLanes + lane]};
  }
  return plane;
}

class LaneTransformTest : public ::testing::TestWithParam<int> {};

// Single precision: a sum of size^2 values of magnitude 1 is off by about
// 1e-7 size log(size); 1e-4 relative to the largest leaves room.
TEST_P(LaneTransformTest, EveryLaneIsTheFourierTransform) {
  const int size = GetParam();
  const std::vector<float> cells = RandomCells(size);
  std::vector<float> transformed = cells;
  LaneTransform transform(size);
  transform.Forward(transformed.data(), 0, size);
  for (int lane = 0; lane < kLanes; ++lane) {
    cv::Mat expected;
    cv::dft(Lane(cells, size, lane), expected);
    EXPECT_LT(cv::norm(Lane(transformed, size, lane), expected, cv::NORM_INF),
              1e-4 * cv::norm(expected, cv::NORM_INF))
        << "lane " << lane;
  }
}

TEST_P(LaneTransformTest, InverseUndoesForwardInTheRowsAskedFor) {
  const int size = GetParam();
  const int first = size / 3;
  const int end = size / 2 + 1;
  std::vector<float> cells = RandomCells(size);
  const std::vector<float> before = cells;
  LaneTransform transform(size);
  // What lies outside the rows is to be taken as zero.
  transform.Forward(cells.data(), first, end);
  transform.Inverse(cells.data(), first, end);
  for (int i = first * size * kGroup; i < end * size * kGroup; ++i) {
    ASSERT_NEAR(cells[i] / static_cast<float>(size * size), before[i], 1e-4)
        << i;
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes,
                         LaneTransformTest,
                         ::testing::Values(6, 8, 9, 12, 24, 32, 48, 54));

}  // namespace
}  // namespace groundlock::target::internal
