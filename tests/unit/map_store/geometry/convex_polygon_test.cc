// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/convex_polygon.h"

#include <gtest/gtest.h>

#include <random>

namespace groundlock::geometry {
namespace {

using Eigen::Vector2d;

TEST(ConvexPolygon, HullOfASquareAndWhatIsInIt) {
  const ConvexPolygon hull = ConvexHull({{2, 1},
                                         {0, 0},
                                         {4, 4},
                                         {4, 0},
                                         {0, 4},
                                         {2, 0},    // on an edge
                                         {0, 4}});  // twice
  ASSERT_EQ(hull.corners_px.size(), 4U);
  EXPECT_EQ(hull.corners_px[0], Vector2d(0, 0));
  EXPECT_EQ(hull.corners_px[1], Vector2d(4, 0));
  EXPECT_EQ(hull.corners_px[2], Vector2d(4, 4));
  EXPECT_EQ(hull.corners_px[3], Vector2d(0, 4));
  EXPECT_TRUE(hull.Contains({1, 3}));
  EXPECT_TRUE(hull.Contains({4, 2}));
  EXPECT_FALSE(hull.Contains({4.01, 2}));
  EXPECT_FALSE(hull.Contains({-1, -1}));
}

// A diamond holds half of the box about it.
TEST(ConvexPolygon, CornersOfTheBoxAboutItAreOutside) {
  const ConvexPolygon diamond{{{0, -2}, {2, 0}, {0, 2}, {-2, 0}}};
  EXPECT_TRUE(diamond.Contains({0.9, 0.9}));
  for (const double x : {-1.1, 1.1}) {
    for (const double y : {-1.1, 1.1}) EXPECT_FALSE(diamond.Contains({x, y}));
  }
}

TEST(ConvexPolygon, HoldsAllThatItWasMadeOf) {
  std::mt19937 random(1);
  std::normal_distribution<double> spread(0.0, 30.0);
  for (int round = 0; round < 50; ++round) {
    std::vector<Vector2d> points(24);
    for (Vector2d& point : points) {
      for (double& axis : point) axis = spread(random);
    }
    const ConvexPolygon hull = ConvexHull(points);
    for (const Vector2d& point : points) {
      EXPECT_TRUE(hull.Contains(point));
      EXPECT_EQ(hull.Bounds().min_px, hull.Bounds().min_px.cwiseMin(point));
      EXPECT_EQ(hull.Bounds().max_px, hull.Bounds().max_px.cwiseMax(point));
    }
    // None of its corners is superfluous.
    for (std::size_t i = 0; i < hull.corners_px.size(); ++i) {
      ConvexPolygon less = hull;
      less.corners_px.erase(less.corners_px.begin() +
                            static_cast<std::ptrdiff_t>(i));
      EXPECT_FALSE(less.Contains(hull.corners_px[i]));
    }
  }
}

TEST(ConvexPolygon, WhatHasNoAreaHoldsNothing) {
  for (const ConvexPolygon& hull :
       {ConvexHull({}),
        ConvexHull({{1, 1}}),
        ConvexHull({{1, 1}, {1, 1}, {1, 1}}),
        ConvexHull({{0, 0}, {1, 1}, {2, 2}, {3, 3}})}) {
    EXPECT_LT(hull.corners_px.size(), 3U);
    EXPECT_FALSE(hull.Contains({1, 1}));
  }
}

}  // namespace
}  // namespace groundlock::geometry
