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

FollowedPoint Told() {
  FollowedPoint point;
  point.Forget();
  point.Follow(From(0.0), 10s);
  point.Tell(0.01);
  return point;
}

TEST(FollowedPoint, IsTheMiddleOfTheDrawnBoxAtFirst) {
  FollowedPoint point;
  point.Follow(From(40.0), 25s);
  EXPECT_DOUBLE_EQ(point.variance(), 0.05 * 0.05);
  point.Forget();
  EXPECT_DOUBLE_EQ(point.variance(), 0.15 * 0.15);
}

TEST(FollowedPoint, GoesAstraySlowlyWhereTheViewStays) {
  FollowedPoint point = Told();
  const double told = point.variance();
  for (int i = 1; i <= 10; ++i) point.Follow(From(i % 3), 10s + i * 100ms);
  EXPECT_NEAR(point.variance(), told + 0.03 * 0.03, 1e-9);
}

TEST(FollowedPoint, IsAnyOnceTheViewHasTurnedOrTheBodyIsAnother) {
  FollowedPoint forgotten;
  forgotten.Forget();
  const double any = forgotten.variance();
  FollowedPoint turned = Told();
  turned.Follow(From(15.0), 10s);
  EXPECT_GT(turned.variance(), 0.4 * any);
  EXPECT_LT(turned.variance(), 0.6 * any);
  turned.Follow(From(45.0), 10s);
  EXPECT_DOUBLE_EQ(turned.variance(), any);
  FollowedPoint another = Told();
  EXPECT_LT(another.variance(), 0.1 * any);
  another.Forget();
  EXPECT_DOUBLE_EQ(another.variance(), any);
}

}  // namespace
}  // namespace groundlock::tracking
