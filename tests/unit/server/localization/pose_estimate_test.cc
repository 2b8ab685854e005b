// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/pose_estimate.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using geometry::Vector6d;
using test_support::MakeWorldFromCamera;

Vector6d RandomVector(std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  Vector6d vector;
  for (double& value : vector) value = normal(engine);
  return vector;
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
  // To rounding, which contracted arithmetic does elsewhere.
  EXPECT_LT(PoseDifference(MakeWorldFromCamera(), MakeWorldFromCamera()).norm(),
            1e-15);
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

}  // namespace
}  // namespace groundlock::localization
