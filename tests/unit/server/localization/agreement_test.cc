// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/agreement.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "tests/support/perturbation.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

TEST(CountPlaces, WhatLiesCloseTogetherCountsOnce) {
  const geometry::CameraModel camera = test_support::MakeCamera();
  ASSERT_EQ(camera.width_px(), 1280);
  EXPECT_EQ(CountPlaces({}, camera), 0);
  // Squares of 32 px.
  std::vector<Eigen::Vector2d> pixels_px = {{0.5, 0.5}, {31.0, 31.0}};
  EXPECT_EQ(CountPlaces(pixels_px, camera), 1);
  pixels_px.emplace_back(32.5, 31.0);
  pixels_px.emplace_back(31.0, 32.5);
  EXPECT_EQ(CountPlaces(pixels_px, camera), 3);
  // What lies outside is not of the image.
  pixels_px.emplace_back(1280.5, 10.0);
  pixels_px.emplace_back(1e300, -1e300);
  EXPECT_EQ(CountPlaces(pixels_px, camera), 3);
}

TEST(LogFalseAlarms, IsTheBinomialTail) {
  // P(X >= 2) of three coins is a half.
  const double hypotheses = LogFalseAlarms({0, 3}, 0.5);
  EXPECT_NEAR(LogFalseAlarms({2, 3}, 0.5) - hypotheses, std::log(0.5), 1e-12);
  EXPECT_NEAR(
      LogFalseAlarms({3, 3}, 0.1) - hypotheses, 3.0 * std::log(0.1), 1e-12);
  // P(X >= 1) = 1 - 0.7^4.
  EXPECT_NEAR(LogFalseAlarms({1, 4}, 0.3) - hypotheses,
              std::log(1.0 - std::pow(0.7, 4)),
              1e-12);
  // One more that agrees is always better, also where most do or few are.
  for (int agreeing = 1; agreeing <= 400; ++agreeing) {
    EXPECT_LT(LogFalseAlarms({agreeing, 400}, 0.2),
              LogFalseAlarms({agreeing - 1, 400}, 0.2) + 1e-12);
  }
  EXPECT_NEAR(LogFalseAlarms({400, 400}, 0.5) - hypotheses,
              400.0 * std::log(0.5),
              1e-9);
}

TEST(LogFalseAlarms, AreAsManyAsItSays) {
  // Of 100,000 draws by chance, those at least as good as one that is expected
  // in a thousandth of them: 100, within four standard deviations.
  std::mt19937_64 engine(test_support::PerturbedSeed(5));
  const double hypotheses = LogFalseAlarms({0, 40}, 0.2);
  std::binomial_distribution<int> draw(40, 0.2);
  int threshold = 0;
  while (LogFalseAlarms({threshold, 40}, 0.2) - hypotheses > std::log(1e-3)) {
    ++threshold;
  }
  const double expected =
      1e5 * std::exp(LogFalseAlarms({threshold, 40}, 0.2) - hypotheses);
  int found = 0;
  for (int i = 0; i < 100'000; ++i) found += draw(engine) >= threshold ? 1 : 0;
  EXPECT_LT(std::abs(found - expected), 4.0 * std::sqrt(expected));
}

TEST(IsSure, AsksForMoreThanToBeBelieved) {
  const double believed = std::log(kFalseAlarmsPerFrame);
  EXPECT_TRUE(IsBelieved(believed));
  EXPECT_FALSE(IsSure(believed));
  const double sure = std::log(kFalseAlarmsOfSure);
  EXPECT_FALSE(IsSure(sure + 0.1));
  EXPECT_TRUE(IsSure(sure - 0.1));
  EXPECT_TRUE(IsBelieved(sure));
}

TEST(LogFalseAlarmsOverDecoy, AFrameMustBeatItsMirrorImage) {
  const auto is_believed = [](int agreeing, int places) {
    return IsBelieved(LogFalseAlarmsOverDecoy({agreeing, places}));
  };
  EXPECT_FALSE(is_believed(0, 0));
  EXPECT_FALSE(is_believed(12, 12));
  EXPECT_TRUE(is_believed(40, 40));
  EXPECT_TRUE(is_believed(150, 200));
  // What a symmetric facade gives to both says nothing.
  EXPECT_FALSE(is_believed(150, 300));
  EXPECT_FALSE(is_believed(50, 200));
}

TEST(AgreementOverDecoy, APlaceIsWhoseMatchIsMoreLikeTheMap) {
  const geometry::CameraModel camera = test_support::MakeCamera();
  // Squares of 32 px, in a row.
  const auto at = [](int square, int squared_distance) {
    return Likeness{{32.0 * square + 5.0, 5.0}, squared_distance};
  };
  const std::vector<Likeness> pose = {
      at(0, 900), at(1, 100), at(2, 500), at(4, 70), at(4, 20), at(5, 3)};
  const std::vector<Likeness> decoy = {
      at(1, 200), at(2, 400), at(3, 10), at(4, 50), at(5, 3)};
  const Agreement agreement = AgreementOverDecoy(pose, decoy, camera);
  EXPECT_EQ(agreement.agreeing, 3) << "0, 1, and 4 by the better of two";
  EXPECT_EQ(agreement.places, 5) << "5 is neither's";
  const Agreement other = AgreementOverDecoy(decoy, pose, camera);
  EXPECT_EQ(other.agreeing, 2);
  EXPECT_EQ(other.places, 5);
  const std::vector<Likeness> outside = {{{-1.0, 5.0}, 1}, {{1e300, 5.0}, 1}};
  EXPECT_EQ(AgreementOverDecoy(outside, {}, camera).places, 0);
}

}  // namespace
}  // namespace groundlock::localization
