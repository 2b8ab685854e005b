// SPDX-License-Identifier: Apache-2.0
// What the filter makes of a gyroscope, a receiver of satellites' signals and a
// compass.
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "tests/unit/server/localization/pose_filter_test.h"

namespace groundlock::localization {
namespace {

TEST(PoseFilter, LearnsAGyroscopesBiasAndTurnsByIt) {
  PoseFilterOptions options;
  options.imu.emplace();
  PoseFilter filter(options);
  PoseFilter blind(PoseFilterOptions{});
  const Eigen::Vector3d bias(0.04, -0.03, 0.06);
  const auto start = FromMap(PoseAt(nanoseconds(0)));
  filter.Start(nanoseconds(0), start);
  blind.Start(nanoseconds(0), start);
  // From frame 60 on, it turns as nobody expects.
  const auto pose = [](int frame) {
    Vector6d motion = Vector6d::Zero();
    motion(4) = 0.03 * std::max(0, frame - 60);
    return MovePose(PoseAt(frame * kStep), motion);
  };
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0.0, 1.2e-4 * std::sqrt(200.0));
  for (int i = 1; i <= 75; ++i) {
    filter.Remember(PoseFilter::kLastFrame);
    filter.Propagate(i * kStep);
    blind.Propagate(i * kStep);
    const Eigen::Vector3d turned = geometry::RotationVector(
        pose(i - 1).rotation.conjugate() * pose(i).rotation);
    Gyroscope gyroscope(*options.imu);
    std::vector<InertialSample> samples;
    for (int k = 0; k <= 8; ++k) {
      samples.push_back(
          {(i - 1) * kStep + k * milliseconds(5),
           turned / 0.04 + bias +
               Eigen::Vector3d{noise(random), noise(random), noise(random)},
           {}});
    }
    gyroscope.Add(samples);
    const auto turn = gyroscope.Between(
        (i - 1) * kStep, i * kStep, filter.gyroscope_errors());
    ASSERT_TRUE(turn);
    filter.UpdateFromGyroscope(PoseFilter::kLastFrame, *turn);
    if (i > 60) continue;
    ASSERT_TRUE(filter.UpdateFromMap(FromMap(pose(i))));
    ASSERT_TRUE(blind.UpdateFromMap(FromMap(pose(i))));
  }
  EXPECT_LT((filter.gyroscope_errors().bias_rad_s - bias).norm(), 5e-3);
  const double with = AngleError_rad(filter.pose().world_from_camera, pose(75));
  EXPECT_GT(AngleError_rad(blind.pose().world_from_camera, pose(75)), 0.3);
  EXPECT_LT(with, 0.01);
  // What is learnt outlives a new start.
  const Eigen::Vector3d learnt = filter.gyroscope_errors().bias_rad_s;
  filter.Start(75 * kStep, FromMap(pose(75)));
  EXPECT_EQ(filter.gyroscope_errors().bias_rad_s, learnt);
}

// What the gyroscope has measured of a step is no jolt: what is followed, a
// milliradian off and surer of itself than it may be, must not turn the camera
// by calling it one.
TEST(PoseFilter, AJoltLeavesTheTurnThatAGyroscopeMeasured) {
  PoseFilterOptions options;
  options.imu.emplace();
  options.imu->gyroscope_bias_rad_s = 0.0;
  const auto follow = [&](bool by_gyroscope) {
    PoseFilter filter(options);
    filter.Start(nanoseconds(0), FromMap(Rigid3()));
    filter.Remember(PoseFilter::kKeyFrame);
    filter.Remember(PoseFilter::kLastFrame);
    filter.Propagate(kStep);
    if (by_gyroscope) {
      GyroscopeTurn turn;
      turn.duration_s = 0.04;
      turn.sample_period_s = 0.005;
      turn.error_jacobian = 0.04 * ErrorJacobianOfRate(Eigen::Vector3d::Zero());
      filter.UpdateFromGyroscope(PoseFilter::kLastFrame, turn);
    }
    // The camera was pushed by 0.5 m, and is said to have turned by 1 mrad.
    Vector6d motion = Vector6d::Zero();
    motion(0) = 0.5;
    motion(4) = 1e-3;
    Matrix6d covariance = Sharp();
    covariance.bottomRightCorner<3, 3>() *= 0.01;
    EXPECT_TRUE(filter.UpdateRelative(PoseFilter::kKeyFrame,
                                      Rigid3(),
                                      {MovePose(Rigid3(), motion), covariance},
                                      kWhateverItTakes));
    const Rigid3 pose = filter.pose().world_from_camera;
    EXPECT_NEAR(pose.translation.x(), 0.5, 0.01);
    return AngleError_rad(pose, Rigid3());
  };
  EXPECT_GT(follow(false), 0.9e-3);
  EXPECT_LT(follow(true), 0.2e-3);
}

// The map is not seen for two seconds, as long as a pose is held; the arm to
// the antenna is half a metre.
TEST(PoseFilter, OtherSensorsSteerThePoseWhereNothingIsSeen) {
  const Eigen::Vector3d arm(0.3, -0.4, 0.1);
  const Eigen::Vector3d error(0.12, -0.2, 0.15);
  const Eigen::Quaterniond turned =
      geometry::QuaternionFromRotationVector({0.02, -0.01, 0.03});
  const auto tell = [&](PoseFilter& filter, nanoseconds time) {
    const Rigid3 truth = PoseAt(time);
    EXPECT_TRUE(filter.UpdateFromPosition(
        {truth.translation + truth.rotation * arm + error, 0.2, arm}));
    EXPECT_TRUE(filter.UpdateFromAttitude({turned * truth.rotation, 0.03}));
  };
  PoseFilter told = Moving(3);
  PoseFilter blind = told;
  for (int i = 4; i <= 50; ++i) {
    for (PoseFilter* filter : {&told, &blind}) {
      filter->Propagate(i * kStep);
      ASSERT_TRUE(filter->UpdateFromMap(FromMap(PoseAt(i * kStep))));
    }
    tell(told, i * kStep);
  }
  // Beside the map they say nothing.
  EXPECT_LT(CenterError(told.pose().world_from_camera, PoseAt(50 * kStep)),
            1e-3);
  for (int i = 51; i <= 100; ++i) {
    told.Propagate(i * kStep);
    blind.Propagate(i * kStep);
    tell(told, i * kStep);
  }
  const Rigid3 truth = PoseAt(100 * kStep);
  EXPECT_GT(CenterError(blind.pose().world_from_camera, truth), 1.0);
  // What they err was learnt while the map was seen: it is 0.28 m and 2
  // degrees.
  EXPECT_LT(CenterError(told.pose().world_from_camera, truth), 0.1);
  EXPECT_LT(AngleError_rad(told.pose().world_from_camera, truth), 0.015);
  EXPECT_LT(Nees(told.pose(), truth), 3.0 * 6.0);
  EXPECT_GT(told.pose().covariance(0, 0), 1e-4);

  // Wrong ones are told by what is known, and change nothing.
  const PoseEstimate before = told.pose();
  EXPECT_FALSE(told.UpdateFromPosition(
      {truth.translation + Eigen::Vector3d(0.0, 5.0, 0.0), 0.2, arm}));
  EXPECT_FALSE(told.UpdateFromAttitude(
      {geometry::QuaternionFromRotationVector({0.0, 0.0, 0.8}) * truth.rotation,
       0.03}));
  EXPECT_EQ(told.pose().covariance, before.covariance);
  EXPECT_EQ(told.pose().world_from_camera.translation,
            before.world_from_camera.translation);
}

// The error of such a sensor is one and the same for long: a thousand fixes in
// ten seconds are hardly better than one. It was learnt while the map was seen;
// ten seconds later what is known of it has faded as the process says (a time
// constant of 60 s).
TEST(PoseFilter, FixesDoNotAverageOut) {
  constexpr double kSigma = 0.2;
  PoseFilter filter{PoseFilterOptions()};
  const Rigid3 place = PoseAt(nanoseconds(0));
  filter.Start(nanoseconds(0), FromMap(place));
  for (int i = 1; i <= 1'000; ++i) {
    filter.Propagate(i * milliseconds(10));
    ASSERT_TRUE(filter.UpdateFromPosition(
        {place.translation, kSigma, Eigen::Vector3d::Zero()}));
  }
  const double faded = kSigma * kSigma * (1.0 - std::exp(-2.0 * 10.0 / 60.0));
  EXPECT_NEAR(filter.pose().covariance(0, 0), faded, 0.1 * faded);
}

}  // namespace
}  // namespace groundlock::localization
