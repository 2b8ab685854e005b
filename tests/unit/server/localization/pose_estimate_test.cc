// SPDX-License-Identifier: Apache-2.0
#include "server/localization/pose_estimate.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cstdint>
#include <random>

#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;
using test_support::MakeWorldFromCamera;

Vector6d RandomVector(std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  Vector6d vector;
  for (double& value : vector) value = normal(engine);
  return vector;
}

Matrix6d RandomCovariance(std::mt19937_64& engine) {
  Matrix6d A;
  for (int column = 0; column < 6; ++column)
    A.col(column) = RandomVector(engine);
  return 1e-4 * (A * A.transpose() + 0.1 * Matrix6d::Identity());
}

TEST(PoseDifference, UndoesMovePose) {
  std::mt19937_64 engine(1);
  for (int i = 0; i < 100; ++i) {
    const Rigid3 pose = MovePose(MakeWorldFromCamera(), RandomVector(engine));
    Vector6d difference = RandomVector(engine);
    // Rotation vectors are unique below half a turn.
    difference.tail<3>() *= 3.0 / (1.0 + difference.tail<3>().norm());
    EXPECT_LT(
        (PoseDifference(pose, MovePose(pose, difference)) - difference).norm(),
        1e-12);
  }
  EXPECT_EQ(PoseDifference(MakeWorldFromCamera(), MakeWorldFromCamera()).norm(),
            0.0);
}

TEST(PoseDifference, FollowsTheConventionOfRigid3) {
  // R_true = Exp(dtheta) R_estimated, dp in world.
  const Rigid3 from = MakeWorldFromCamera();
  const Eigen::Quaterniond turn(
      Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()));
  const Rigid3 to{turn * from.rotation,
                  from.translation + Eigen::Vector3d(1.0, 2.0, 3.0)};
  Vector6d expected;
  expected << 1.0, 2.0, 3.0, 0.0, 0.0, 0.1;
  EXPECT_LT((PoseDifference(from, to) - expected).norm(), 1e-12);
}

TEST(TransportCovariance, MatchesTheNumericalJacobian) {
  std::mt19937_64 engine(2);
  const Rigid3 from = MakeWorldFromCamera();
  Vector6d motion;
  motion << 0.8, -1.7, 0.4, 0.2, -0.5, 0.3;
  const Rigid3 to = MovePose(from, motion);
  const Rigid3 from_from_to = from.Inverse() * to;
  Matrix6d J;
  constexpr double kStep = 1e-6;
  for (int i = 0; i < 6; ++i) {
    const Vector6d step = kStep * Vector6d::Unit(i);
    J.col(i) = PoseDifference(MovePose(from, -step) * from_from_to,
                              MovePose(from, step) * from_from_to) /
               (2.0 * kStep);
  }
  const Matrix6d covariance = RandomCovariance(engine);
  const Matrix6d transported =
      TransportCovariance({from, covariance}, to.translation);
  const Matrix6d expected = J * covariance * J.transpose();
  // Central differences of 1e-6 leave 1e-10 of rounding.
  EXPECT_LT((transported - expected).norm(), 1e-8 * expected.norm());
  // Nothing moved: nothing changes.
  EXPECT_EQ(TransportCovariance({from, covariance}, from.translation),
            covariance);
}

TEST(FusePoses, IsTheInformationForm) {
  std::mt19937_64 engine(3);
  for (int i = 0; i < 50; ++i) {
    const PoseEstimate predicted{MakeWorldFromCamera(),
                                 RandomCovariance(engine)};
    const Vector6d difference = 0.01 * RandomVector(engine);
    const PoseEstimate measured{
        MovePose(predicted.world_from_camera, difference),
        RandomCovariance(engine)};
    const PoseEstimate fused = FusePoses(predicted, measured, 1e9);
    const Matrix6d covariance =
        (predicted.covariance.inverse() + measured.covariance.inverse())
            .inverse();
    const Vector6d moved =
        covariance * measured.covariance.inverse() * difference;
    EXPECT_LT((fused.covariance - covariance).norm(), 1e-9 * covariance.norm());
    EXPECT_LT(
        (PoseDifference(predicted.world_from_camera, fused.world_from_camera) -
         moved)
            .norm(),
        1e-9);
    EXPECT_LT((fused.covariance - fused.covariance.transpose()).norm(), 1e-15);
  }
}

TEST(FusePoses, ContradictionReturnsTheMeasured) {
  const PoseEstimate predicted{MakeWorldFromCamera(),
                               1e-4 * Matrix6d::Identity()};
  const PoseEstimate measured{
      MovePose(predicted.world_from_camera, 0.1 * Vector6d::Unit(0)),
      2e-4 * Matrix6d::Identity()};
  // 0.1^2 / 3e-4 = 33.3.
  const PoseEstimate apart = FusePoses(predicted, measured, 33.0);
  EXPECT_EQ(apart.world_from_camera.translation,
            measured.world_from_camera.translation);
  EXPECT_EQ(apart.covariance, measured.covariance);
  const PoseEstimate fused = FusePoses(predicted, measured, 34.0);
  EXPECT_NEAR(
      PoseDifference(predicted.world_from_camera, fused.world_from_camera)(0),
      0.1 / 3.0,
      1e-12);
}

TEST(FusePoses, CertaintyWins) {
  std::mt19937_64 engine(4);
  const PoseEstimate vague{MakeWorldFromCamera(), RandomCovariance(engine)};
  const PoseEstimate exact{
      MovePose(vague.world_from_camera, Vector6d::Constant(1e-3)),
      Matrix6d::Zero()};
  for (const PoseEstimate& fused :
       {FusePoses(vague, exact, 100.0), FusePoses(exact, vague, 100.0)}) {
    EXPECT_LT(
        PoseDifference(exact.world_from_camera, fused.world_from_camera).norm(),
        1e-12);
    EXPECT_LT(fused.covariance.norm(), 1e-15);
  }
  // Two that are certain of different things: the later one.
  const PoseEstimate other{vague.world_from_camera, Matrix6d::Zero()};
  EXPECT_EQ(FusePoses(exact, other, 100.0).world_from_camera.translation,
            other.world_from_camera.translation);
}

}  // namespace
}  // namespace groundlock::localization
