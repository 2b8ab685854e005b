// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/likely_places.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

namespace groundlock::tracking {
namespace {

using Eigen::Vector2d;
using geometry::Box2;

constexpr double kScale = 0.125;

// Of an image of 1,280 x 720 pixels.
cv::Mat Nowhere() { return cv::Mat(90, 160, CV_32F, cv::Scalar(0.1)); }

void Paint(cv::Mat& probability, const Box2& box_px, double value) {
  probability(cv::Rect2d(kScale * box_px.x(),
                         kScale * box_px.y(),
                         kScale * box_px.width(),
                         kScale * box_px.height()))
      .setTo(value);
}

TEST(ColourMap, IsWhatABoxHasMoreThanWhatIsAroundIt) {
  cv::Mat probability = Nowhere();
  const Box2 car = Box2::FromCenter({640, 360}, {160, 80});
  Paint(probability, car, 0.9);
  const ColourMap colours(probability, kScale);
  EXPECT_GT(colours.Excess(car), 0.0);
  // The same of what is all of one colour, of half the car, and beside it.
  EXPECT_NEAR(
      colours.Excess(Box2::FromCenter({200, 200}, {160, 80})), 0.0, 1e-9);
  EXPECT_LT(colours.Excess(Box2::FromCenter({640, 360}, {80, 40})),
            colours.Excess(car));
  EXPECT_LT(colours.Excess(Box2::FromCenter({720, 360}, {160, 80})),
            0.7 * colours.Excess(car));
  // Of a few pixels chance says as much as of many.
  Paint(probability, Box2::FromCenter({100, 100}, {16, 8}), 0.9);
  const ColourMap both(probability, kScale);
  EXPECT_LT(both.Excess(Box2::FromCenter({100, 100}, {16, 8})),
            0.3 * both.Excess(car));
  // Outside there is nothing.
  EXPECT_LE(both.Excess(Box2::FromCenter({-900, 1e6}, {160, 80})), 0.0);
}

TEST(LikelyPlaces, AreBetweenThoseOfTheGridAndApart) {
  cv::Mat probability = Nowhere();
  const Vector2d first(500, 300);
  const Vector2d second(900, 500);
  Paint(probability, Box2::FromCenter(first, {160, 80}), 0.9);
  Paint(probability, Box2::FromCenter(second, {160, 80}), 0.6);
  std::vector<Vector2d> grid;
  for (int y = 60; y < 720; y += 80) {
    for (int x = 40; x < 1280; x += 120) grid.emplace_back(x, y);
  }
  const auto likely = LikelyPlaces(
      ColourMap(probability, kScale),
      grid,
      [](const Vector2d& center_px) -> std::optional<Box2> {
        // Beyond there is no ground, or none that tells a size.
        if (center_px.y() < 60) return std::nullopt;
        if (center_px.y() < 120) {
          return Box2::FromCenter(center_px, {std::nan(""), 80});
        }
        return Box2::FromCenter(center_px, {160, 80});
      },
      [](const Box2&) { return Vector2d(120, 80); },
      /*most=*/3);
  ASSERT_GE(likely.size(), 2U);
  EXPECT_LE(likely.size(), 3U);
  EXPECT_LT((likely[0] - first).norm(), 30.0);
  EXPECT_LT((likely[1] - second).norm(), 30.0);
}

TEST(LikelyPlaces, AreNoneWhereNothingStandsOut) {
  const std::vector<Vector2d> grid = {{300, 300}, {600, 300}};
  EXPECT_TRUE(
      LikelyPlaces(
          ColourMap(Nowhere(), kScale),
          grid,
          [](const Vector2d& center_px) {
            return std::optional(Box2::FromCenter(center_px, {160, 80}));
          },
          [](const Box2&) { return Vector2d(120, 80); },
          /*most=*/3)
          .empty());
}

}  // namespace
}  // namespace groundlock::tracking
