// SPDX-License-Identifier: Apache-2.0
#include "server/movers/moving_groups.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

namespace groundlock::movers {
namespace {

MovingPoint At(double x, double y, double vx, double vy) {
  return {{x, y}, {vx, vy}, 0.01 * Eigen::Matrix2d::Identity()};
}

TEST(MovingGroups, NeighboursThatMoveAlikeAreOne) {
  const std::vector<MovingPoint> points = {At(100, 100, 2, 0),
                                           At(120, 100, 2.1, 0),
                                           At(140, 110, 1.9, 0.1),
                                           At(400, 100, 2, 0),
                                           At(410, 100, 2, 0)};
  const auto groups = GroupPoints(points, {});
  ASSERT_EQ(groups.size(), 1U);
  EXPECT_THAT(groups[0].members, testing::ElementsAre(0, 1, 2));
  EXPECT_EQ(groups[0].box_px.min_px, Eigen::Vector2d(100, 100));
  EXPECT_EQ(groups[0].box_px.max_px, Eigen::Vector2d(140, 110));
  EXPECT_NEAR(groups[0].velocity_m_s.x(), 2.0, 1e-9);
}

TEST(MovingGroups, NeighboursThatPassEachOtherAreTwo) {
  std::vector<MovingPoint> points;
  for (int i = 0; i < 4; ++i) {
    points.push_back(At(100 + 10 * i, 100, 3, 0));
    points.push_back(At(100 + 10 * i, 104, -3, 0));
  }
  const auto groups = GroupPoints(points, {});
  ASSERT_EQ(groups.size(), 2U);
  EXPECT_GT(groups[0].velocity_m_s.x(), 2.9);
  EXPECT_LT(groups[1].velocity_m_s.x(), -2.9);
}

TEST(MovingGroups, NothingMakesNothing) {
  EXPECT_TRUE(GroupPoints({}, {}).empty());
}

}  // namespace
}  // namespace groundlock::movers
