// SPDX-License-Identifier: Apache-2.0
#include "server/localization/camera_motion_filter.h"

#include <gtest/gtest.h>

#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeWorldFromCamera;

constexpr nanoseconds kStep = milliseconds(40);

// 1.2 m/s and 0.5 rad/s, about directions of its own.
Rigid3 PoseAt(nanoseconds time) {
  const double t_s = std::chrono::duration<double>(time).count();
  Vector6d motion;
  motion << 1.0 * t_s, -0.6 * t_s, 0.3 * t_s, 0.1 * t_s, -0.2 * t_s, 0.45 * t_s;
  return MovePose(MakeWorldFromCamera(), motion);
}

// A millimetre and a twentieth of a degree.
Matrix6d Sharp() {
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal() << Eigen::Vector3d::Constant(1e-6),
      Eigen::Vector3d::Constant(1e-6);
  return covariance;
}

CameraMotionFilter Moving(int frames) {
  CameraMotionFilter filter{CameraMotionOptions()};
  filter.Start(nanoseconds(0), {PoseAt(nanoseconds(0)), Sharp()});
  for (int i = 1; i <= frames; ++i) {
    filter.Update(i * kStep, {PoseAt(i * kStep), Sharp()});
  }
  return filter;
}

TEST(CameraMotionFilter, ConstantVelocityIsPredictedExactly) {
  const CameraMotionFilter filter = Moving(100);
  EXPECT_EQ(filter.time(), 100 * kStep);
  for (const int ahead : {0, 1, 3, 6}) {
    const nanoseconds time = (100 + ahead) * kStep;
    const Rigid3 predicted = filter.PredictPose(time);
    // Left of the start, at rest, after a hundred frames.
    EXPECT_LT(CenterError(predicted, PoseAt(time)), 1e-5) << ahead;
    EXPECT_LT(AngleError_rad(predicted, PoseAt(time)), 1e-5) << ahead;
  }
  // After few frames it is already close: 48 mm pass between two frames.
  EXPECT_LT(CenterError(Moving(5).PredictPose(6 * kStep), PoseAt(6 * kStep)),
            2e-3);
}

TEST(CameraMotionFilter, PredictsNoFartherThanAStepAndNotBackwards) {
  const CameraMotionFilter filter = Moving(50);
  const nanoseconds end = 50 * kStep;
  const Rigid3 longest = filter.PredictPose(end + milliseconds(250));
  EXPECT_EQ(filter.PredictPose(end + std::chrono::hours(1)).translation,
            longest.translation);
  EXPECT_EQ(filter.PredictPose(nanoseconds(0)).translation,
            filter.PredictPose(end).translation);
}

TEST(CameraMotionFilter, HoldsADirectionThatIsWeaklyDetermined) {
  CameraMotionFilter filter = Moving(50);
  Matrix6d weak = Sharp();
  weak(1, 1) = 0.05 * 0.05;
  double held_m = 0.0;
  double followed_m = 0.0;
  for (int i = 51; i <= 60; ++i) {
    // The measurement wanders to both sides, by 3 cm in y and 2 mm in x.
    const double side = i % 2 == 0 ? 1.0 : -1.0;
    Rigid3 measured = PoseAt(i * kStep);
    measured.translation += Eigen::Vector3d(0.002 * side, 0.03 * side, 0.0);
    const PoseEstimate estimate = filter.Update(i * kStep, {measured, weak});
    const Eigen::Vector3d error =
        estimate.world_from_camera.translation - PoseAt(i * kStep).translation;
    held_m = std::max(held_m, std::abs(error.y()));
    followed_m = std::max(followed_m, std::abs(error.x()));
    // It knows y better than the measurement does, and no better than the
    // camera's acceleration allows.
    EXPECT_LT(estimate.covariance(1, 1), 0.5 * weak(1, 1));
    EXPECT_GT(estimate.covariance(1, 1), estimate.covariance(0, 0));
  }
  EXPECT_LT(held_m, 0.012);
  EXPECT_GT(followed_m, 0.001);
}

TEST(CameraMotionFilter, ShiftKeepsTheRelativeMotion) {
  CameraMotionFilter filter = Moving(50);
  CameraMotionFilter shifted = filter;
  const Rigid3 correction{
      geometry::QuaternionFromRotationVector({0.3, -0.2, 0.5}),
      {2.0, -1.0, 0.5}};
  shifted.Shift(correction);
  for (const int ahead : {0, 1, 5}) {
    const nanoseconds time = (50 + ahead) * kStep;
    const Rigid3 expected = correction * filter.PredictPose(time);
    EXPECT_LT(CenterError(shifted.PredictPose(time), expected), 1e-12);
    EXPECT_LT(AngleError_rad(shifted.PredictPose(time), expected), 1e-7);
  }
  // Measurements in the new world agree with it.
  const nanoseconds next = 51 * kStep;
  const Rigid3 one =
      filter.Update(next, {PoseAt(next), Sharp()}).world_from_camera;
  const Rigid3 two = shifted.Update(next, {correction * PoseAt(next), Sharp()})
                         .world_from_camera;
  EXPECT_LT(CenterError(correction * one, two), 1e-6);
}

TEST(CameraMotionFilter, ReferenceIsExactAndKeepsTheVelocity) {
  CameraMotionFilter filter = Moving(50);
  const Rigid3 before = filter.PredictPose(51 * kStep);
  filter.MakeReference();
  EXPECT_EQ(filter.PredictPose(51 * kStep).translation, before.translation);
  // Nothing is learned from a vague measurement; what the pose is uncertain by
  // is the velocity's error and the acceleration over one step:
  // 4 m/s^2 (40 ms)^2 / 2 = 3.2 mm.
  const PoseEstimate estimate = filter.Update(
      51 * kStep, {PoseAt(51 * kStep), 1e6 * Matrix6d::Identity()});
  EXPECT_LT(estimate.covariance(0, 0), 0.006 * 0.006);
  EXPECT_GT(estimate.covariance(0, 0), 0.0032 * 0.0032);
}

TEST(CameraMotionFilter, GapsAndContradictionsStartAnew) {
  const auto expect_at_rest = [](const CameraMotionFilter& filter,
                                 nanoseconds time,
                                 const Rigid3& pose) {
    EXPECT_EQ(filter.time(), time);
    EXPECT_EQ(filter.PredictPose(time + kStep).translation, pose.translation);
  };
  for (const nanoseconds late :
       {nanoseconds(milliseconds(251)), nanoseconds(0), -kStep}) {
    CameraMotionFilter filter = Moving(50);
    const nanoseconds time = 50 * kStep + late;
    const PoseEstimate measured{PoseAt(time), Sharp()};
    const PoseEstimate estimate = filter.Update(time, measured);
    EXPECT_EQ(estimate.world_from_camera.translation,
              measured.world_from_camera.translation);
    EXPECT_EQ(estimate.covariance, measured.covariance);
    expect_at_rest(filter, time, measured.world_from_camera);
  }
  CameraMotionFilter filter = Moving(50);
  Rigid3 elsewhere = PoseAt(51 * kStep);
  elsewhere.translation.z() += 0.5;
  EXPECT_EQ(filter.Update(51 * kStep, {elsewhere, Sharp()})
                .world_from_camera.translation,
            elsewhere.translation);
  expect_at_rest(filter, 51 * kStep, elsewhere);
}

TEST(CameraMotionFilter, CovarianceStaysSymmetricAndPositive) {
  CameraMotionFilter filter = Moving(3);
  for (int i = 4; i < 2'000; ++i) {
    const PoseEstimate estimate =
        filter.Update(i * kStep, {PoseAt(i * kStep), Sharp()});
    if (i % 10 == 0) filter.MakeReference();
    ASSERT_LT((estimate.covariance - estimate.covariance.transpose()).norm(),
              1e-12);
    ASSERT_GT(estimate.covariance.diagonal().minCoeff(), 0.0);
    ASSERT_LE(estimate.covariance.diagonal().maxCoeff(), 1e-6 * 1.001);
  }
}

}  // namespace
}  // namespace groundlock::localization
