// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/robust_pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cstdio>
#include <limits>
#include <vector>

#include "server/localization/solvers/pose_estimate.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using geometry::Vector6d;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeScene;
using test_support::Scene;

std::vector<PoseObservation> ObservationsOf(const Scene& scene) {
  std::vector<PoseObservation> observations;
  for (std::size_t i = 0; i < scene.p_world.size(); ++i) {
    observations.push_back({scene.p_world[i], scene.pixel_px[i]});
  }
  return observations;
}

// Off by 2 cm and 0.3 degrees: up to 7 + 6 px.
Rigid3 Disturbed(const Rigid3& world_from_camera) {
  Vector6d difference;
  difference << 0.012, -0.011, 0.011, 0.003, -0.003, 0.003;
  return MovePose(world_from_camera, difference);
}

TEST(RefinePoseRobustly, NoiselessPoseIsExact) {
  const Scene scene = MakeScene({.num_points = 50});
  const auto pose = RefinePoseRobustly(scene.camera,
                                       ObservationsOf(scene),
                                       Disturbed(scene.world_from_camera),
                                       {});
  ASSERT_TRUE(pose);
  // Gauss-Newton squares the error with each step; rounding remains.
  EXPECT_LT(CenterError(pose->world_from_camera, scene.world_from_camera),
            1e-9);
  EXPECT_LT(AngleError_rad(pose->world_from_camera, scene.world_from_camera),
            1e-7);  // an angle from a dot product: sqrt of rounding
  EXPECT_EQ(pose->num_inliers, 50);
  EXPECT_LT(pose->rms_error_px, 1e-6);
  EXPECT_LT(pose->covariance.norm(), 1e-12);
}

TEST(RefinePoseRobustly, OutliersDoNotCount) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const Scene scene = MakeScene({.num_points = 200,
                                   .noise_px = 0.5,
                                   .outlier_ratio = 0.3,
                                   .seed = seed});
    const auto observations = ObservationsOf(scene);
    const auto pose = RefinePoseRobustly(
        scene.camera, observations, Disturbed(scene.world_from_camera), {});
    ASSERT_TRUE(pose) << "seed " << seed;
    const Vector6d error =
        PoseDifference(pose->world_from_camera, scene.world_from_camera);
    // Chi-squared with 6 degrees of freedom: 99.999 %.
    EXPECT_LT(error.dot(pose->covariance.inverse() * error), 33.1)
        << "seed " << seed;
    int inliers = 0;
    for (std::size_t i = 0; i < observations.size(); ++i) {
      inliers += pose->is_inlier[i];
      // Five sigma pass, outliers only by chance.
      if (!scene.is_outlier[i]) {
        EXPECT_EQ(pose->is_inlier[i], 1);
      }
      const auto pixel_px = scene.camera.ImageFromCamera(
          pose->world_from_camera.Inverse() * observations[i].p_world);
      EXPECT_EQ(pose->is_inlier[i] != 0,
                (*pixel_px - observations[i].pixel_px).norm() < 2.5);
    }
    EXPECT_EQ(inliers, pose->num_inliers);
    EXPECT_NEAR(pose->rms_error_px, 0.5 * std::sqrt(2.0), 0.12);
  }
}

// Where residuals are small, a pixel and a half is an outlier.
TEST(RefinePoseRobustly, TheGateNarrowsToTheResiduals) {
  const Scene scene = MakeScene({.num_points = 200, .noise_px = 0.15});
  auto observations = ObservationsOf(scene);
  for (std::size_t i = 0; i < 16; ++i) observations[i].pixel_px.x() += 1.5;
  RobustPoseOptions options;
  const auto wide = RefinePoseRobustly(
      scene.camera, observations, scene.world_from_camera, options);
  options.least_gate_px = 0.7;
  const auto narrow = RefinePoseRobustly(
      scene.camera, observations, scene.world_from_camera, options);
  ASSERT_TRUE(wide && narrow);
  EXPECT_EQ(wide->num_inliers, 200);
  EXPECT_EQ(narrow->num_inliers, 184);
  for (std::size_t i = 0; i < observations.size(); ++i) {
    EXPECT_EQ(narrow->is_inlier[i] != 0, i >= 16) << i;
  }
  EXPECT_LT(narrow->covariance.trace(), 0.5 * wide->covariance.trace());
  // Never below what was asked for.
  options.least_gate_px = 2.0;
  EXPECT_EQ(RefinePoseRobustly(
                scene.camera, observations, scene.world_from_camera, options)
                ->num_inliers,
            200);
}

// A near landmark before a far wall moves the camera as it likes, unless one
// knows how the camera moves.
TEST(RefinePoseRobustly, WhatIsExpectedTellsALongLeverThatIsWrong) {
  const Scene scene = MakeScene({.num_points = 150,
                                 .min_depth_m = 15.0,
                                 .max_depth_m = 17.0,
                                 .noise_px = 0.2});
  auto observations = ObservationsOf(scene);
  RobustPoseOptions options;
  options.least_gate_px = 0.7;
  const auto far_ones = RefinePoseRobustly(
      scene.camera, observations, scene.world_from_camera, options);
  const Eigen::Vector3d near_world =
      scene.world_from_camera * Eigen::Vector3d(-0.3, 0.4, 2.0);
  const Eigen::Vector2d near_px = *scene.camera.ImageFromCamera(
      scene.world_from_camera.Inverse() * near_world);
  observations.push_back({near_world, near_px + Eigen::Vector2d(0.0, 6.0)});
  const auto pulled = RefinePoseRobustly(
      scene.camera, observations, scene.world_from_camera, options);
  ASSERT_TRUE(far_ones && pulled);
  EXPECT_EQ(pulled->is_inlier.back(), 1);
  EXPECT_GT(CenterError(pulled->world_from_camera, scene.world_from_camera),
            0.008);

  Vector6d off;
  off << 0.002, -0.002, 0.001, 1e-4, -1e-4, 1e-4;
  ExpectedPose expected{MovePose(scene.world_from_camera, off)};
  expected.covariance.diagonal() << 1e-5, 1e-5, 1e-5, 1e-7, 1e-7, 1e-7;
  options.expected = expected;
  const auto told = RefinePoseRobustly(
      scene.camera, observations, expected.world_from_camera, options);
  ASSERT_TRUE(told);
  EXPECT_EQ(told->is_inlier.back(), 0);
  // And is no part of the result, far from what it does to it above: another
  // start may only change which of the others lie just within the gate.
  EXPECT_LT(CenterError(told->world_from_camera, far_ones->world_from_camera),
            1e-3);
  EXPECT_NEAR(told->covariance.trace(),
              far_ones->covariance.trace(),
              1e-2 * far_ones->covariance.trace());
  // A right one agrees with both.
  observations.back().pixel_px = near_px;
  const auto right = RefinePoseRobustly(
      scene.camera, observations, expected.world_from_camera, options);
  ASSERT_TRUE(right);
  EXPECT_EQ(right->is_inlier.back(), 1);
}

// Nor does it where little is known of how the camera moves, as between two
// frames of a slow video: all others together say where it must be seen.
TEST(RefinePoseRobustly, TheOthersTellALongLeverThatIsWrong) {
  constexpr std::uint64_t kScenes = 100;
  int right_ones = 0;
  for (std::uint64_t seed = 1; seed <= kScenes; ++seed) {
    const Scene scene = MakeScene({.num_points = 150,
                                   .min_depth_m = 15.0,
                                   .max_depth_m = 17.0,
                                   .noise_px = 0.2,
                                   .seed = seed});
    auto observations = ObservationsOf(scene);
    const Eigen::Vector3d near_world =
        scene.world_from_camera * Eigen::Vector3d(-0.3, 0.4, 2.0);
    const Eigen::Vector2d near_px = *scene.camera.ImageFromCamera(
        scene.world_from_camera.Inverse() * near_world);
    // As far off as one was on a car that drove past (sim/lot, `occlusion`).
    observations.push_back({near_world, near_px + Eigen::Vector2d(0.0, -15.0)});
    RobustPoseOptions options;
    options.least_gate_px = 0.7;
    Vector6d off;
    off << 0.01, -0.01, 0.01, 1e-3, -1e-3, 1e-3;
    ExpectedPose expected{MovePose(scene.world_from_camera, off)};
    // 3 cm and 10 mrad.
    expected.covariance.diagonal() << 9e-4, 9e-4, 9e-4, 1e-4, 1e-4, 1e-4;
    options.expected = expected;
    const auto pose = RefinePoseRobustly(
        scene.camera, observations, expected.world_from_camera, options);
    ASSERT_TRUE(pose) << "seed " << seed;
    EXPECT_EQ(pose->is_inlier.back(), 0) << "seed " << seed;
    const Vector6d error =
        PoseDifference(pose->world_from_camera, scene.world_from_camera);
    // Chi-squared with 6 degrees of freedom: 99.999 %.
    EXPECT_LT(error.dot(pose->covariance.inverse() * error), 33.1)
        << "seed " << seed;
    observations.back().pixel_px = near_px;
    const auto right = RefinePoseRobustly(
        scene.camera, observations, expected.world_from_camera, options);
    ASSERT_TRUE(right) << "seed " << seed;
    if (right->is_inlier.back() == 0) continue;
    ++right_ones;
    EXPECT_LT(right->covariance.topLeftCorner(3, 3).trace(),
              0.5 * pose->covariance.topLeftCorner(3, 3).trace())
        << "seed " << seed;
  }
  // A right one counts fully, though it alone tells where the camera is. What
  // the wall's noise and the expectation are off by may leave one out.
  std::printf("%d of %d right ones\n", right_ones, static_cast<int>(kScenes));
  EXPECT_GE(right_ones, 0.85 * kScenes);
}

TEST(RefinePoseRobustly, WeightsAreRelative) {
  // Everything is seen twice, the second time 0.2 px to the right with a ninth
  // of the weight: as if seen once, a tenth of the way.
  const Scene scene = MakeScene({.num_points = 60});
  const Eigen::Vector2d shift_px(0.2, 0.0);
  std::vector<PoseObservation> twice;
  std::vector<PoseObservation> once;
  std::vector<PoseObservation> shifted;
  for (std::size_t i = 0; i < scene.p_world.size(); ++i) {
    const Eigen::Vector2d& pixel_px = scene.pixel_px[i];
    twice.push_back({scene.p_world[i], pixel_px, 9.0});
    twice.push_back({scene.p_world[i], pixel_px + shift_px, 1.0});
    once.push_back({scene.p_world[i], pixel_px + 0.1 * shift_px});
    shifted.push_back({scene.p_world[i], pixel_px + shift_px});
  }
  const auto refine = [&](const std::vector<PoseObservation>& observations) {
    return RefinePoseRobustly(
               scene.camera, observations, scene.world_from_camera, {})
        .value();
  };
  const RobustPose pose = refine(twice);
  const Vector6d whole = PoseDifference(scene.world_from_camera,
                                        refine(shifted).world_from_camera);
  const Vector6d apart =
      PoseDifference(refine(once).world_from_camera, pose.world_from_camera);
  // Tukey's weight of 0.2 px under a gate of 2.5 px is 0.987.
  EXPECT_LT(apart.norm(), 0.01 * whole.norm());

  // Their unit does not matter.
  for (PoseObservation& observation : twice) observation.weight *= 1e-3;
  const RobustPose rescaled = refine(twice);
  EXPECT_LT(CenterError(rescaled.world_from_camera, pose.world_from_camera),
            1e-9);
  EXPECT_NEAR(rescaled.rms_error_px, pose.rms_error_px, 1e-9);
  EXPECT_LT((rescaled.covariance - pose.covariance).norm(),
            1e-6 * pose.covariance.norm());
}

TEST(RefinePoseRobustly, CovarianceIsThatOfTheError) {
  constexpr int kTrials = 300;
  double sum = 0.0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Scene scene =
        MakeScene({.num_points = 60,
                   .noise_px = 0.5,
                   .seed = static_cast<std::uint64_t>(100 + trial)});
    const auto pose = RefinePoseRobustly(
        scene.camera, ObservationsOf(scene), scene.world_from_camera, {});
    ASSERT_TRUE(pose);
    const Vector6d error =
        PoseDifference(pose->world_from_camera, scene.world_from_camera);
    sum += error.dot(pose->covariance.inverse() * error);
  }
  // Mean of chi-squared with 6 degrees of freedom, and 114/112 because the
  // variance is estimated; sqrt(12 / 300) = 0.2 is its standard deviation.
  EXPECT_NEAR(sum / kTrials, 6.1, 0.6);
}

TEST(RefinePoseRobustly, TooLittleGivesNothing) {
  const Scene scene = MakeScene({.num_points = 30});
  const std::vector<PoseObservation> all = ObservationsOf(scene);
  const auto refine = [&](const std::vector<PoseObservation>& observations) {
    return RefinePoseRobustly(
        scene.camera, observations, scene.world_from_camera, {});
  };
  EXPECT_FALSE(refine({}));
  EXPECT_FALSE(refine({all.begin(), all.begin() + 5}));
  EXPECT_TRUE(refine({all.begin(), all.begin() + 6}));
  // Six that do not agree.
  std::vector<PoseObservation> apart(all.begin(), all.begin() + 6);
  apart[3].pixel_px.x() += 200.0;
  EXPECT_FALSE(refine(apart));
  // Behind the camera.
  EXPECT_FALSE(RefinePoseRobustly(
      scene.camera,
      all,
      {scene.world_from_camera.rotation * Eigen::Quaterniond(Eigen::AngleAxisd(
                                              M_PI, Eigen::Vector3d::UnitY())),
       scene.world_from_camera.translation},
      {}));
  std::vector<PoseObservation> unweighted = all;
  for (PoseObservation& observation : unweighted) observation.weight = 0.0;
  EXPECT_FALSE(refine(unweighted));
}

// The camera can turn around a line of landmarks, and anywhere about a single
// one, without a change in the image: no pose is better than any other.
TEST(RefinePoseRobustly, DegenerateLandmarksGiveNothing) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const Scene scene =
        MakeScene({.num_points = 2, .noise_px = 0.3, .seed = seed});
    for (const double length : {1.0, 0.0}) {
      std::vector<PoseObservation> line;
      for (int i = 0; i <= 30; ++i) {
        const Eigen::Vector3d p_world =
            scene.p_world[0] +
            length * i / 30.0 * (scene.p_world[1] - scene.p_world[0]);
        line.push_back({p_world,
                        *scene.camera.ImageFromCamera(
                            scene.world_from_camera.Inverse() * p_world)});
      }
      EXPECT_FALSE(RefinePoseRobustly(
          scene.camera, line, Disturbed(scene.world_from_camera), {}))
          << "seed " << seed << " length " << length;
    }
  }
}

// A flat wall fixes the pose, if weakly.
TEST(RefinePoseRobustly, APlaneIsEnough) {
  Scene scene = MakeScene({.num_points = 40});
  for (std::size_t i = 0; i < scene.p_world.size(); ++i) {
    const Eigen::Vector2d xy =
        *scene.camera.NormalizedFromImage(scene.pixel_px[i]);
    scene.p_world[i] =
        scene.world_from_camera * Eigen::Vector3d(8.0 * xy.homogeneous());
  }
  const auto pose = RefinePoseRobustly(scene.camera,
                                       ObservationsOf(scene),
                                       Disturbed(scene.world_from_camera),
                                       {});
  ASSERT_TRUE(pose);
  EXPECT_LT(CenterError(pose->world_from_camera, scene.world_from_camera),
            1e-6);
}

TEST(RefinePoseRobustly, WildPredictionsGiveNothingWild) {
  const Scene scene = MakeScene({.num_points = 50});
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  for (const double value : {1e3, 1e12, 1e200, kNan}) {
    Rigid3 wild = scene.world_from_camera;
    wild.translation.x() += value;
    EXPECT_FALSE(
        RefinePoseRobustly(scene.camera, ObservationsOf(scene), wild, {}))
        << value;
  }
}

}  // namespace
}  // namespace groundlock::localization
