// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/pose_refinement.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <limits>

#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using geometry::Vector6d;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeScene;
using test_support::Scene;

// (dp, dtheta) of rigid3.h's convention.
Rigid3 Perturbed(const Rigid3& world_from_camera, const Vector6d& delta) {
  return {geometry::QuaternionFromRotationVector(delta.tail<3>()) *
              world_from_camera.rotation,
          world_from_camera.translation + delta.head<3>()};
}

Vector6d Difference(const Rigid3& truth, const Rigid3& estimate) {
  Vector6d delta;
  delta << truth.translation - estimate.translation,
      geometry::RotationVector(truth.rotation * estimate.rotation.conjugate());
  return delta;
}

TEST(ReprojectionResidual, JacobianIsTheDerivative) {
  const Scene scene = MakeScene({.num_points = 50, .noise_px = 3.0});
  // Central differences: step^2 times third derivatives of about 1e3 px plus
  // rounding 1e-10 / step.
  constexpr double kStep = 1e-5;
  constexpr double kTolerance = 1e-4;
  for (std::size_t i = 0; i < scene.p_world.size(); ++i) {
    Eigen::Matrix<double, 2, 6> jacobian;
    ASSERT_TRUE(ReprojectionResidual(scene.camera,
                                     scene.world_from_camera,
                                     scene.p_world[i],
                                     scene.pixel_px[i],
                                     &jacobian));
    for (int column = 0; column < 6; ++column) {
      const auto at = [&](double step) {
        return *ReprojectionResidual(
            scene.camera,
            Perturbed(scene.world_from_camera, step * Vector6d::Unit(column)),
            scene.p_world[i],
            scene.pixel_px[i],
            nullptr);
      };
      const Eigen::Vector2d numeric = (at(kStep) - at(-kStep)) / (2.0 * kStep);
      EXPECT_LT((numeric - jacobian.col(column)).norm(), kTolerance)
          << "point " << i << " column " << column;
    }
  }
}

TEST(ReprojectionResidual, NothingBehindTheCamera) {
  const Scene scene = MakeScene({.num_points = 1});
  const Eigen::Vector3d behind =
      scene.world_from_camera * Eigen::Vector3d(0.0, 0.0, -5.0);
  EXPECT_FALSE(ReprojectionResidual(scene.camera,
                                    scene.world_from_camera,
                                    behind,
                                    scene.pixel_px[0],
                                    nullptr));
}

TEST(RefinePose, NoiselessPoseIsRecovered) {
  const Scene scene = MakeScene({});
  Vector6d delta;
  delta << 0.2, -0.15, 0.1, 0.02, -0.03, 0.01;
  const auto refined = RefinePose(scene.camera,
                                  scene.p_world,
                                  scene.pixel_px,
                                  Perturbed(scene.world_from_camera, delta),
                                  {.max_iterations = 100});
  ASSERT_TRUE(refined.ok()) << refined.status();
  // Ceres stops at a relative decrease of 1e-6.
  EXPECT_LT(CenterError(refined->world_from_camera, scene.world_from_camera),
            1e-6);
  EXPECT_LT(AngleError_rad(refined->world_from_camera, scene.world_from_camera),
            1e-7);
  EXPECT_LT(refined->mean_error_px, 1e-4);
}

// Normalised estimation error squared: dx' cov^-1 dx is chi-squared with six
// degrees of freedom if the covariance is right.
TEST(RefinePose, CovarianceIsConsistent) {
  constexpr int kTrials = 1200;
  for (const double noise_px : {0.2, 0.5, 1.0}) {
    double sum = 0.0;
    for (int trial = 0; trial < kTrials; ++trial) {
      const Scene scene =
          MakeScene({.num_points = 150,
                     .noise_px = noise_px,
                     .seed = static_cast<std::uint64_t>(trial) + 1});
      const auto refined = RefinePose(scene.camera,
                                      scene.p_world,
                                      scene.pixel_px,
                                      scene.world_from_camera,
                                      {});
      ASSERT_TRUE(refined.ok()) << refined.status();
      const Vector6d dx =
          Difference(scene.world_from_camera, refined->world_from_camera);
      sum += dx.dot(refined->covariance.llt().solve(dx));
    }
    // Means of 300 draws had a mean of 6.12 and a standard deviation of 0.27 in
    // 60 perturbed rounds (of exact normal errors 6.04, for the variance is
    // itself estimated, and 0.2); so those of 1200 are within four standard
    // deviations of half of that.
    EXPECT_NEAR(sum / kTrials, 6.0, 0.7) << "noise " << noise_px << " px";
  }
}

TEST(RefinePose, LossKeepsOutliersFromPulling) {
  Scene scene = MakeScene({.noise_px = 0.3, .seed = 7});
  for (std::size_t i = 0; i < scene.pixel_px.size(); i += 10) {
    scene.pixel_px[i].x() += 25.0;  // one in ten, all to the same side
  }
  // How far the true points end up from where they were seen, at worst.
  const auto error_px = [&](double loss_scale_px) {
    const auto refined = RefinePose(scene.camera,
                                    scene.p_world,
                                    scene.pixel_px,
                                    scene.world_from_camera,
                                    {.loss_scale_px = loss_scale_px});
    EXPECT_TRUE(refined.ok()) << refined.status();
    double worst_px = 0.0;
    for (const Eigen::Vector3d& p_world : scene.p_world) {
      const Eigen::Vector2d truth_px = *scene.camera.ImageFromCamera(
          scene.world_from_camera.Inverse() * p_world);
      worst_px = std::max(worst_px,
                          ReprojectionResidual(scene.camera,
                                               refined->world_from_camera,
                                               p_world,
                                               truth_px,
                                               nullptr)
                              ->norm());
    }
    return worst_px;
  };
  // Least squares follows the mean of the outliers, 25 px / 10.
  EXPECT_GT(error_px(1e6), 2.0);
  // 0.3 px / sqrt(200 points), times the leverage of six parameters.
  EXPECT_LT(error_px(1.0), 0.3);
}

TEST(RefinePose, ChecksItsInput) {
  const Scene scene = MakeScene({.num_points = 10});
  const auto code = [&](std::span<const Eigen::Vector3d> p_world,
                        std::span<const Eigen::Vector2d> pixel_px,
                        const PoseRefinementOptions& options) {
    return RefinePose(scene.camera,
                      p_world,
                      pixel_px,
                      scene.world_from_camera,
                      options)
        .status()
        .code();
  };
  const std::span p_world(scene.p_world);
  const std::span pixel_px(scene.pixel_px);
  EXPECT_EQ(code(p_world, pixel_px.first(9), {}),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code(p_world.first(3), pixel_px.first(3), {}),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(p_world, pixel_px, {.loss_scale_px = 0.0}),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code(p_world, pixel_px, {.max_iterations = 0}),
            absl::StatusCode::kInvalidArgument);
}

TEST(RefinePose, OnePointManyTimesDoesNotFixThePose) {
  const Scene scene = MakeScene({.num_points = 1});
  const std::vector<Eigen::Vector3d> p_world(20, scene.p_world[0]);
  const std::vector<Eigen::Vector2d> pixel_px(20, scene.pixel_px[0]);
  EXPECT_EQ(
      RefinePose(scene.camera, p_world, pixel_px, scene.world_from_camera, {})
          .status()
          .code(),
      absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace groundlock::localization
