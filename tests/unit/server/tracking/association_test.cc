// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/association.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace groundlock::tracking {
namespace {

// Of three sigmas to each side of a prediction known to a pixel.
constexpr double kReach_px2 = std::numbers::pi * 9.0;

TEST(AssociationProbability, IsBayesRuleAgainstEvenlySpreadClutter) {
  const Innovation innovation{.surprise = 7.0, .sigma_px2 = 1.0};
  const double density =
      std::exp(-3.5) / (2.0 * std::numbers::pi) / (1.0 - std::exp(-0.5 * 9.0));
  const double clutter = 1.0 / kReach_px2;
  const double expected = 0.8 * density / (0.8 * density + 0.2 * clutter);
  EXPECT_LT(expected, 0.5);
  EXPECT_NEAR(
      AssociationProbability(0.8, innovation, kReach_px2), expected, 1e-12);
}

TEST(AssociationProbability, APredictionThatHoldsIsNoNews) {
  for (const double looks : {0.0, 0.3, 0.99, 1.0}) {
    EXPECT_DOUBLE_EQ(AssociationProbability(looks, {0.0, 1.0}, kReach_px2),
                     looks);
  }
}

TEST(AssociationProbability, OneThatLeavesThePlaceOpenSaysNothing) {
  const double area_px2 = 1e9;
  // The edge of the reach is hardly farther from the middle of such a Gaussian.
  EXPECT_NEAR(
      AssociationProbability(0.6, {9.0 / area_px2, area_px2}, kReach_px2),
      0.6,
      1e-6);
}

TEST(AssociationProbability, TheFartherTheLessLikely) {
  double before = 1.0;
  for (double surprise = 5.0; surprise < 60.0; surprise += 5.0) {
    const double now =
        AssociationProbability(0.95, {surprise, 1.0}, kReach_px2);
    EXPECT_LT(now, before);
    EXPECT_GE(now, 0.0);
    before = now;
  }
  EXPECT_LT(before, 1e-6);
}

TEST(AssociationProbability, WithoutACovarianceLooksAreAllThereIs) {
  EXPECT_EQ(AssociationProbability(0.7, {NAN, 1.0}, kReach_px2), 0.7);
  EXPECT_EQ(AssociationProbability(0.7, {1.0, NAN}, kReach_px2), 0.7);
  EXPECT_EQ(AssociationProbability(0.7, {1.0, 1.0}, 0.0), 0.7);
}

TEST(SeenLikelihood, IsADensityAboutWhereItWasSeen) {
  const geometry::Box2 seen_px = geometry::Box2::FromXywh(100, 60, 40, 20);
  double sum = 0.0;
  for (double x = 60.5; x < 180.0; ++x) {
    for (double y = 30.5; y < 110.0; ++y)
      sum += SeenLikelihood(seen_px, {x, y});
  }
  EXPECT_NEAR(sum, 1.0, 1e-3);
}

TEST(SeenLikelihood, OfTwoTheOneIsFoundThatIsKnownToBeThere) {
  const geometry::Box2 seen_px = geometry::Box2::FromXywh(100, 60, 40, 20);
  // One that has not been seen for a while may be here as well as elsewhere.
  const Innovation vague{.surprise = 0.0, .sigma_px2 = 60.0 * 60.0};
  const Innovation sure{.surprise = 0.0, .sigma_px2 = 1.5 * 1.5};
  EXPECT_GT(SeenLikelihood(seen_px, seen_px.center_px()), Likelihood(vague));
  EXPECT_LT(SeenLikelihood(seen_px, seen_px.center_px()), Likelihood(sure));
  EXPECT_LT(
      SeenLikelihood(seen_px, seen_px.center_px() + Eigen::Vector2d(40, 0)),
      Likelihood(vague));
}

// A target 40 px large that goes 4 px a frame and is known to do so to 1 px.
MotionEvidence Steady(const Eigen::Vector2d& found_px) {
  return {.found_px = found_px,
          .predicted_px = {104.0, 50.0},
          .sigma_px = 1.0,
          .left_behind_px = Eigen::Vector2d(100.0, 50.0),
          .side_px = 40.0};
}

TEST(MotionRatio, WhatStaysBehindIsNotTheTarget) {
  EXPECT_EQ(MotionRatio(Steady({104.0, 50.0})), 1.0);
  const double stays = MotionRatio(Steady({100.0, 50.0}));
  EXPECT_LT(stays, 0.3);
  // Which a tracker that is sure outweighs, and one that is not does not.
  EXPECT_GT(Associate(0.97, stays), 0.5);
  EXPECT_LT(Associate(0.7, stays), 0.5);
}

TEST(MotionRatio, AnUnsteadyOrRestingTargetLosesNothing) {
  MotionEvidence unsteady = Steady({100.0, 50.0});
  unsteady.sigma_px = 20.0;
  EXPECT_GT(MotionRatio(unsteady), 0.9);
  MotionEvidence resting = Steady({100.5, 50.0});
  resting.predicted_px = {100.0, 50.0};
  EXPECT_EQ(MotionRatio(resting), 1.0);
  MotionEvidence unknown = Steady({0.0, 0.0});
  unknown.left_behind_px.reset();
  EXPECT_EQ(MotionRatio(unknown), 1.0);
}

TEST(Associate, KeepsWhatIsCertain) {
  EXPECT_EQ(Associate(0.0, 0.5), 0.0);
  EXPECT_EQ(Associate(1.0, 0.5), 1.0);
  EXPECT_EQ(Associate(0.3, 1.0), 0.3);
}

}  // namespace
}  // namespace groundlock::tracking
