// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/followed_point.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <numbers>

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using namespace std::chrono_literals;

Vector3d From(double angle_deg) {
  const double angle_rad = angle_deg * std::numbers::pi / 180.0;
  return {std::cos(angle_rad), std::sin(angle_rad), 0.0};
}

constexpr double kAny = 0.15 * 0.15;

FollowedPoint Told() {
  FollowedPoint point;
  point.Follow(From(0.0), 10s);
  point.Tell(0.1);
  return point;
}

TEST(FollowedPoint, IsTheMiddleOfTheDrawnBoxAtFirst) {
  FollowedPoint point;
  point.Follow(From(40.0), 25s);
  EXPECT_DOUBLE_EQ(point.variance(), 0.05 * 0.05);
}

TEST(FollowedPoint, GoesAstraySlowlyWhereTheViewStays) {
  FollowedPoint point = Told();
  const double told = point.variance();
  for (int i = 1; i <= 10; ++i) point.Follow(From(i % 3), 10s + i * 100ms);
  EXPECT_NEAR(point.variance(), told + 0.03 * 0.03, 1e-9);
}

TEST(FollowedPoint, IsAnyOnceTheViewHasTurned) {
  FollowedPoint turned = Told();
  EXPECT_LT(turned.variance(), 0.1 * kAny);
  turned.Follow(From(15.0), 10s);
  EXPECT_GT(turned.variance(), 0.4 * kAny);
  EXPECT_LT(turned.variance(), 0.6 * kAny);
  turned.Follow(From(45.0), 10s);
  EXPECT_DOUBLE_EQ(turned.variance(), kAny);
}

TEST(FollowedPoint, FitsThatErrAlikeCountForOne) {
  FollowedPoint point = Told();
  EXPECT_DOUBLE_EQ(point.TellByFit(10s, true), 1.0);
  EXPECT_DOUBLE_EQ(point.variance(), 0.08 * 0.08);
  // Eight in a second are worth one.
  EXPECT_NEAR(point.TellByFit(10s + 125ms, true), 1.0 / 9.0, 1e-9);
  EXPECT_NEAR(point.TellByFit(10s + 250ms, true), 1.0 / 10.0, 1e-9);
  // One that comes much later counts for more, and what a silhouette has told
  // is not given up for it.
  point.Follow(From(90.0), 20s);
  EXPECT_GT(point.TellByFit(20s, true), 0.7);
  point.Tell(0.01);
  EXPECT_LT(point.TellByFit(30s, true), 0.02);
  // But for one that nothing links to it.
  EXPECT_DOUBLE_EQ(point.TellByFit(31s, false), 1.0);
  EXPECT_DOUBLE_EQ(point.variance(), 0.08 * 0.08);
}

}  // namespace
}  // namespace groundlock::tracking
