// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/pose_ransac.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <random>

#include "tests/support/synthetic_scene.h"

namespace groundlock::geometry {
namespace {

using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeScene;
using test_support::Scene;

std::array<Eigen::Vector3d, 3> Rays(const Scene& scene) {
  std::array<Eigen::Vector3d, 3> rays;
  for (int i = 0; i < 3; ++i) {
    rays[i] = *scene.camera.RayFromImage(scene.pixel_px[i]);
  }
  return rays;
}

std::array<Eigen::Vector3d, 3> Points(const Scene& scene) {
  return {scene.p_world[0], scene.p_world[1], scene.p_world[2]};
}

TEST(SolveP3p, OneOfItsSolutionsIsTheTruth) {
  int found = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    const Scene scene = MakeScene({.num_points = 3, .seed = seed});
    const std::vector<Rigid3> solutions = SolveP3p(Rays(scene), Points(scene));
    EXPECT_LE(solutions.size(), 4U);
    for (const Rigid3& camera_from_world : solutions) {
      const Rigid3 pose = camera_from_world.Inverse();
      // Rounding of a quartic's roots, amplified by thin triangles.
      if (CenterError(pose, scene.world_from_camera) < 1e-5 &&
          AngleError_rad(pose, scene.world_from_camera) < 1e-5) {
        ++found;
        break;
      }
    }
  }
  // Random triangles are now and then nearly degenerate (the centre near the
  // danger cylinder), where a double root loses half the digits.
  EXPECT_GE(found, 196);
}

TEST(SolveP3p, CollinearPointsAndEqualRaysGiveNothing) {
  const Scene scene = MakeScene({.num_points = 3});
  std::array<Eigen::Vector3d, 3> points = Points(scene);
  points[2] = 0.5 * (points[0] + points[1]);
  EXPECT_TRUE(SolveP3p(Rays(scene), points).empty());
  std::array<Eigen::Vector3d, 3> rays = Rays(scene);
  rays[1] = rays[0];
  EXPECT_TRUE(SolveP3p(rays, Points(scene)).empty());
  points = Points(scene);
  points[1] = points[0];
  EXPECT_TRUE(SolveP3p(Rays(scene), points).empty());
  points[1].setConstant(std::numeric_limits<double>::quiet_NaN());
  EXPECT_TRUE(SolveP3p(Rays(scene), points).empty());
}

TEST(EstimatePoseRansac, NoiselessPoseIsExact) {
  const Scene scene = MakeScene({.num_points = 100});
  const auto report =
      EstimatePoseRansac(scene.camera, scene.p_world, scene.pixel_px, {});
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->inliers.size(), 100U);
  EXPECT_LE(report->iterations, 10);
  const Rigid3 pose = report->camera_from_world.Inverse();
  // A sample of three: its own conditioning times the rounding.
  EXPECT_LT(CenterError(pose, scene.world_from_camera), 1e-4);
  EXPECT_LT(AngleError_rad(pose, scene.world_from_camera), 1e-5);
}

class Outliers : public testing::TestWithParam<double> {};

TEST_P(Outliers, AreTold) {
  int recovered = 0;
  constexpr int kTrials = 20;
  for (int trial = 0; trial < kTrials; ++trial) {
    const auto seed = static_cast<std::uint64_t>(trial);
    const Scene scene = MakeScene({.num_points = 400,
                                   .noise_px = 0.5,
                                   .outlier_ratio = GetParam(),
                                   .seed = seed + 100});
    const auto report = EstimatePoseRansac(
        scene.camera, scene.p_world, scene.pixel_px, {.seed = seed});
    ASSERT_TRUE(report.ok()) << report.status();
    EXPECT_LE(report->iterations, 1'000);
    // An outlier falls within 2 px of its place with a probability of
    // pi 2^2 / (1280 * 720) = 1.4e-5; near the border of the gate a rough pose
    // loses some inliers.
    int wrong = 0;
    for (const int index : report->inliers) wrong += scene.is_outlier[index];
    const double right = static_cast<double>(report->inliers.size()) - wrong;
    const double expected = 400.0 * (1.0 - GetParam());
    if (wrong <= 1 && right > 0.7 * expected) ++recovered;
  }
  // 75 % outliers need 587 samples for one to be clean with 0.9999; the limit
  // is 1000, of which 16 are. Noise makes more than half of these too rough: in
  // 33 of 6,000 such trials all of them were, of other seeds. Three in 20 are
  // then one case in 5,000.
  EXPECT_GE(recovered, GetParam() < 0.75 ? kTrials : kTrials - 2);
}

INSTANTIATE_TEST_SUITE_P(Ratios, Outliers, testing::Values(0.2, 0.5, 0.75));

TEST(EstimatePoseRansac, SameSeedSameResult) {
  const Scene scene =
      MakeScene({.noise_px = 0.5, .outlier_ratio = 0.5, .seed = 9});
  const auto a = EstimatePoseRansac(
      scene.camera, scene.p_world, scene.pixel_px, {.seed = 5});
  const auto b = EstimatePoseRansac(
      scene.camera, scene.p_world, scene.pixel_px, {.seed = 5});
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->inliers, b->inliers);
  EXPECT_EQ(a->iterations, b->iterations);
  EXPECT_EQ(a->camera_from_world.translation, b->camera_from_world.translation);
}

TEST(EstimatePoseRansac, PlanarSceneIsNoSpecialCase) {
  Scene scene = MakeScene({.num_points = 150, .seed = 4});
  // All on the ground z = 0, seen where the rays meet it.
  scene.p_world.clear();
  std::vector<Eigen::Vector2d> pixel_px;
  for (const Eigen::Vector2d& pixel : scene.pixel_px) {
    const Eigen::Vector3d ray_world =
        scene.world_from_camera.rotation * *scene.camera.RayFromImage(pixel);
    if (ray_world.z() > -0.05) continue;
    scene.p_world.push_back(scene.world_from_camera.translation -
                            scene.world_from_camera.translation.z() /
                                ray_world.z() * ray_world);
    pixel_px.push_back(pixel);
  }
  ASSERT_GT(pixel_px.size(), 50U);
  const auto report =
      EstimatePoseRansac(scene.camera, scene.p_world, pixel_px, {});
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->inliers.size(), pixel_px.size());
  EXPECT_LT(
      CenterError(report->camera_from_world.Inverse(), scene.world_from_camera),
      1e-3);
}

TEST(EstimatePoseRansac, DegenerateInputIsAnErrorNotAPose) {
  const Scene scene = MakeScene({.num_points = 50});
  const std::vector<Eigen::Vector3d> same(50, scene.p_world[0]);
  EXPECT_EQ(EstimatePoseRansac(scene.camera, same, scene.pixel_px, {})
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
  std::vector<Eigen::Vector3d> line;
  for (int i = 0; i < 50; ++i) line.emplace_back(i, 2.0 * i, 5.0);
  EXPECT_EQ(EstimatePoseRansac(scene.camera, line, scene.pixel_px, {})
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(EstimatePoseRansac, ChecksItsInput) {
  const Scene scene = MakeScene({.num_points = 3});
  EXPECT_EQ(EstimatePoseRansac(scene.camera, scene.p_world, scene.pixel_px, {})
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(
      EstimatePoseRansac(
          scene.camera, scene.p_world, std::span(scene.pixel_px).first(2), {})
          .status()
          .code(),
      absl::StatusCode::kInvalidArgument);
  for (const PoseRansacOptions& options :
       {PoseRansacOptions{.max_error_px = 0.0},
        PoseRansacOptions{.max_error_px =
                              std::numeric_limits<double>::quiet_NaN()},
        PoseRansacOptions{.confidence = 1.0},
        PoseRansacOptions{.max_iterations = 0}}) {
    EXPECT_EQ(options.Validate().code(), absl::StatusCode::kInvalidArgument);
  }
}

TEST(FindInliers, GateIsInPixelsOfTheDistortedImage) {
  Scene scene = MakeScene({.num_points = 40, .seed = 2});
  for (std::size_t i = 0; i < scene.pixel_px.size(); ++i) {
    scene.pixel_px[i].x() += i % 2 == 0 ? 1.99 : 2.01;
  }
  const std::vector<int> inliers =
      FindInliers(scene.camera,
                  scene.world_from_camera.Inverse(),
                  scene.p_world,
                  scene.pixel_px,
                  2.0);
  ASSERT_EQ(inliers.size(), 20U);
  for (const int index : inliers) EXPECT_EQ(index % 2, 0);
}

}  // namespace
}  // namespace groundlock::geometry
