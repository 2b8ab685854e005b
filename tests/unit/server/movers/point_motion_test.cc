// SPDX-License-Identifier: Apache-2.0
#include "server/movers/point_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

namespace groundlock::movers {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kSigma = 0.5 / 1'000.0;  // half a pixel at f = 1000

// A drone that flies along y at 20 m, looking forward and down by 35 degrees,
// and swerves a little.
std::vector<KeyView> Flight(double speed_m_s) {
  std::vector<KeyView> views;
  for (int i = 0; i < 9; ++i) {
    const double t_s = 0.1 * i;
    KeyView view;
    view.time_s = 100.0 + t_s;
    const double pitch = -(90.0 + 35.0) * M_PI / 180.0;
    view.world_from_camera.rotation =
        Eigen::AngleAxisd(0.05 * std::sin(3.0 * t_s), Vector3d::UnitZ()) *
        Eigen::AngleAxisd(pitch, Vector3d::UnitX());
    view.world_from_camera.translation = {
        0.3 * std::sin(2.0 * t_s), speed_m_s * t_s, 20.0};
    views.push_back(view);
  }
  return views;
}

// Where a point is at a time; sightings with noise of kSigma.
std::vector<Sighting> See(const std::vector<KeyView>& views,
                          const std::function<Vector3d(double)>& place,
                          std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0.0, kSigma);
  std::vector<Sighting> sightings;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const Vector3d p =
        views[i].world_from_camera.Inverse() * place(views[i].time_s - 100.0);
    EXPECT_GT(p.z(), 0.0);
    sightings.push_back({i,
                         Vector2d(p.x() / p.z() + noise(random),
                                  p.y() / p.z() + noise(random))});
  }
  return sightings;
}

LocalGround Level() { return {{Vector3d::UnitZ(), 0.0}, 0.1}; }

bool Rests(const RestFit& fit) {
  return fit.chi2 < ChiSquareAt(fit.degrees, 4.0);
}

TEST(PointMotion, WhatRestsOnTheGroundOrAboveItIsExplainedByAPlaceAtRest) {
  const auto views = Flight(8.0);
  for (const double height_m : {0.0, 2.0, 6.0, 15.0}) {
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const RestFit fit =
          FitRest(See(
                      views,
                      [&](double) { return Vector3d(4.0, 40.0, height_m); },
                      seed),
                  views,
                  Level(),
                  {kSigma});
      ASSERT_GT(fit.degrees, 0);
      EXPECT_TRUE(Rests(fit)) << height_m << " m, chi2 " << fit.chi2;
    }
  }
}

TEST(PointMotion, ChiSquareOfWhatRestsIsAsLargeAsItsDegreesOfFreedom) {
  const auto views = Flight(8.0);
  double sum = 0.0;
  double degrees = 0.0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    const RestFit fit = FitRest(
        See(
            views, [](double) { return Vector3d(4.0, 40.0, 6.0); }, seed),
        views,
        Level(),
        {kSigma});
    sum += fit.chi2;
    degrees += fit.degrees;
  }
  // Its standard error over 200 draws of 15 degrees is 2.6 %.
  EXPECT_NEAR(sum / degrees, 1.0, 0.12);
}

TEST(PointMotion, DepthIsThatOfThePlaceAtRest) {
  const auto views = Flight(8.0);
  const Vector3d place(4.0, 40.0, 6.0);
  const RestFit fit = FitRest(See(
                                  views, [&](double) { return place; }, 1),
                              views,
                              Level(),
                              {kSigma});
  const double depth = (views.back().world_from_camera.Inverse() * place).z();
  EXPECT_NEAR(fit.inverse_depth * depth, 1.0, 0.03);
}

TEST(PointMotion, WhatCrossesTheGroundContradictsRestAndGoesAsItGoes) {
  const auto views = Flight(8.0);
  const Vector3d velocity(3.0, 1.0, 0.0);
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const auto sightings = See(
        views,
        [&](double t_s) {
          return Vector3d(Vector3d(4.0, 40.0, 0.0) + t_s * velocity);
        },
        seed);
    EXPECT_FALSE(Rests(FitRest(sightings, views, Level(), {kSigma})));
    const GroundMotion motion =
        FitGroundMotion(sightings, views, Level(), {kSigma}, 1.0);
    ASSERT_GT(motion.degrees, 0);
    EXPECT_LT(motion.chi2, ChiSquareAt(motion.degrees, 3.0));
    const Vector2d error = motion.velocity_m_s - velocity.head<2>();
    const Eigen::Matrix2d covariance =
        motion.covariance.bottomRightCorner<2, 2>();
    // Chi-square of two degrees, once in 30,000.
    EXPECT_LT(error.dot(covariance.inverse() * error), 20.6);
  }
}

// A car that drives ahead of the camera as fast as the camera flies stays where
// it is in the image, as the horizon does: only that nothing rests under the
// ground tells it from what is far away.
TEST(PointMotion, WhatDrivesAheadAtTheCamerasSpeedContradictsRest) {
  const auto views = Flight(8.0);
  const auto sightings = See(
      views,
      [](double t_s) { return Vector3d(0.0, 30.0 + 8.0 * t_s, 0.0); },
      3);
  EXPECT_FALSE(Rests(FitRest(sightings, views, Level(), {kSigma})));
}

TEST(PointMotion, ATurningCarGoesOverTheGround) {
  const auto views = Flight(8.0);
  // 5 m/s on a circle of 5 m.
  const auto sightings = See(
      views,
      [](double t_s) {
        return Vector3d(5.0 * std::cos(t_s), 40.0 + 5.0 * std::sin(t_s), 0.0);
      },
      4);
  const GroundMotion motion =
      FitGroundMotion(sightings, views, Level(), {kSigma}, 1.0);
  EXPECT_LT(motion.chi2 / 4.0, ChiSquareAt(motion.degrees, 3.0));
  EXPECT_NEAR(motion.velocity_m_s.norm(), 5.0, 0.8);
}

TEST(PointMotion, APoseAsUncertainAsItIsSaidToBeMakesNothingMove) {
  auto views = Flight(8.0);
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal(0.0, 1.0);
  const auto seen = See(
      views, [](double) { return Vector3d(4.0, 40.0, 2.0); }, 5);
  for (KeyView& view : views) {
    constexpr double kPlace_m = 0.1;
    constexpr double kTurn_rad = 0.002;
    view.covariance.diagonal() << Vector3d::Constant(kPlace_m * kPlace_m),
        Vector3d::Constant(kTurn_rad * kTurn_rad);
    view.world_from_camera.translation +=
        kPlace_m * Vector3d{normal(random), normal(random), normal(random)};
    view.world_from_camera.rotation =
        geometry::QuaternionFromRotationVector(
            kTurn_rad *
            Vector3d{normal(random), normal(random), normal(random)}) *
        view.world_from_camera.rotation;
  }
  EXPECT_TRUE(Rests(FitRest(seen, views, Level(), {kSigma})));
  for (KeyView& view : views) view.covariance.setZero();
  EXPECT_FALSE(Rests(FitRest(seen, views, Level(), {kSigma})));
}

TEST(PointMotion, TooFewSightingsAndRaysOverTheHorizonSayNothing) {
  const auto views = Flight(8.0);
  EXPECT_EQ(FitRest({}, views, Level(), {kSigma}).degrees, 0);
  const std::vector<Sighting> sky = {
      {0, {0.0, -1.0}}, {1, {0.0, -1.0}}, {2, {0.0, -1.0}}, {3, {0.0, -1.0}}};
  EXPECT_EQ(FitGroundMotion(sky, views, Level(), {kSigma}, 1.0).degrees, 0);
}

TEST(PointMotion, ACameraUnderTheGroundSaysNothing) {
  auto views = Flight(8.0);
  const auto seen = See(
      views, [](double) { return Vector3d(4.0, 40.0, 2.0); }, 5);
  const LocalGround above{{Vector3d::UnitZ(), -30.0}, 0.1};
  EXPECT_EQ(FitRest(seen, views, above, {kSigma}).degrees, 0);
  EXPECT_EQ(FitGroundMotion(seen, views, above, {kSigma}, 1.0).degrees, 0);
}

TEST(PointMotion, ChiSquareQuantilesAreThoseOfTheTables) {
  // 99.9 % of 5 and 15 degrees; Wilson and Hilferty are good to 1.2 % there.
  constexpr double kOneInAThousand = 3.0902;
  EXPECT_NEAR(ChiSquareAt(5, kOneInAThousand), 20.515, 0.26);
  EXPECT_NEAR(ChiSquareAt(15, kOneInAThousand), 37.697, 0.46);
}

}  // namespace
}  // namespace groundlock::movers
