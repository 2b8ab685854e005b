// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/plane.h"

#include <gtest/gtest.h>

#include <random>
#include <set>

namespace groundlock::geometry {
namespace {

Plane Tilted() {
  Plane plane;
  plane.normal = Eigen::Vector3d(0.1, -0.2, 0.9).normalized();
  plane.d = -1.5;
  return plane;
}

// Points on the plane within +-reach, with Gaussian noise along its normal.
std::vector<Eigen::Vector3d> Sample(const Plane& plane,
                                    int count,
                                    double reach,
                                    double sigma,
                                    std::mt19937_64& generator) {
  std::uniform_real_distribution<double> uniform(-reach, reach);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p = plane.Project(
        {uniform(generator), uniform(generator), uniform(generator)});
    points.push_back(p + sigma * noise(generator) * plane.normal);
  }
  return points;
}

double AngleTo(const Plane& a, const Plane& b) {
  return std::acos(std::min(1.0, std::abs(a.normal.dot(b.normal))));
}

TEST(PlaneTest, RaysMeetItInFrontOnly) {
  const Plane ground;
  const auto hit = IntersectRay(ground, {1, 2, 3}, {1, 0, -1});
  ASSERT_TRUE(hit.has_value());
  EXPECT_LT((*hit - Eigen::Vector3d(4, 2, 0)).norm(), 1e-12);
  EXPECT_FALSE(IntersectRay(ground, {1, 2, 3}, {1, 0, 1}).has_value());
  EXPECT_FALSE(IntersectRay(ground, {1, 2, 3}, {1, 0, 0}).has_value());
  EXPECT_FALSE(IntersectRay(ground, {1, 2, 3}, {1e9, 0, -0.5}).has_value());
  EXPECT_FALSE(IntersectRay(ground, {1, 2, 3}, {0, 0, 0}).has_value());
}

TEST(PlaneTest, FitRecoversExactly) {
  std::mt19937_64 generator(1);
  const auto points = Sample(Tilted(), 50, 10.0, 0.0, generator);
  const auto plane = FitPlane(points);
  ASSERT_TRUE(plane.ok()) << plane.status();
  for (const auto& point : points) {
    EXPECT_LT(std::abs(plane->SignedDistance(point)), 1e-12);
  }
}

// Points far off that are ten times as uncertain, and wrong by as much.
TEST(PlaneTest, FitGoesByTheWeights) {
  std::mt19937_64 generator(2);
  std::vector<Eigen::Vector3d> points =
      Sample(Tilted(), 200, 10.0, 0.01, generator);
  std::vector<double> weights(points.size(), 1.0);
  for (std::size_t i = 0; i < points.size(); i += 2) {
    points[i] += 0.1 * Tilted().normal;
    weights[i] = 0.01;
  }
  const auto with = FitPlane(points, weights);
  const auto without = FitPlane(points);
  ASSERT_TRUE(with.ok()) << with.status();
  ASSERT_TRUE(without.ok()) << without.status();
  const Eigen::Vector3d origin = Tilted().Project(Eigen::Vector3d::Zero());
  EXPECT_LT(std::abs(with->SignedDistance(origin)), 0.01);
  EXPECT_GT(std::abs(without->SignedDistance(origin)), 0.03);
  weights.pop_back();
  EXPECT_EQ(FitPlane(points, weights).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(PlaneTest, FitRefusesDegeneratePoints) {
  const std::vector<Eigen::Vector3d> two = {{0, 0, 0}, {1, 0, 0}};
  const std::vector<Eigen::Vector3d> line = {
      {0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {5, 5, 5}};
  const std::vector<Eigen::Vector3d> same(5, Eigen::Vector3d(1, 2, 3));
  const std::vector<Eigen::Vector3d> nan = {{0, 0, NAN}, {1, 0, 0}, {0, 1, 0}};
  const auto code = [](const auto& points) {
    EXPECT_EQ(FitPlane(points).status().code(),
              FitPlaneRansac(points, {}).status().code());
    return FitPlane(points).status().code();
  };
  EXPECT_EQ(code(two), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(line), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(same), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(nan), absl::StatusCode::kInvalidArgument);
}

// Robinson 2014, §3.6.1 with a third of outliers well above the plane.
TEST(PlaneTest, RansacFindsTheGroundAmongOutliers) {
  std::mt19937_64 generator(3);
  std::vector<Eigen::Vector3d> points =
      Sample(Tilted(), 400, 10.0, 0.02, generator);
  std::uniform_real_distribution<double> uniform(-10.0, 10.0);
  for (int i = 0; i < 200; ++i) {
    points.push_back(
        Tilted().Project(
            {uniform(generator), uniform(generator), uniform(generator)}) +
        (3.0 + 0.3 * uniform(generator)) * Tilted().normal);
  }
  const auto result = FitPlaneRansac(points, {});
  ASSERT_TRUE(result.ok()) << result.status();
  // The gate is the mean distance (about 1 m here), so some 30 outliers up to
  // 1 m high take part: they lift the plane by 30 * 0.5 m / 430 = 4 cm on
  // average, by more where chance puts them, and tilt it a little.
  EXPECT_LT(AngleTo(result->plane, Tilted()), 0.02);
  EXPECT_LT(
      std::abs(result->plane.SignedDistance(-Tilted().d * Tilted().normal)),
      0.2);
  const std::set<int> inliers(result->inliers.begin(), result->inliers.end());
  EXPECT_GE(inliers.size(), 400U);
  for (int i = 0; i < 400; ++i) EXPECT_EQ(inliers.count(i), 1U) << i;
}

TEST(PlaneTest, RansacIsDeterministicAndHandlesExactPlanes) {
  std::mt19937_64 generator(4);
  const auto noisy = Sample(Tilted(), 100, 10.0, 0.1, generator);
  EXPECT_EQ(FitPlaneRansac(noisy, {})->inliers,
            FitPlaneRansac(noisy, {})->inliers);
  std::vector<Eigen::Vector3d> exact;
  for (int i = 0; i < 30; ++i) {
    exact.emplace_back(i % 5, i / 5, 2.0);
  }
  const auto result = FitPlaneRansac(exact, {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->inliers.size(), exact.size());
}

TEST(PlaneTest, RansacSamplesLargeSets) {
  std::mt19937_64 generator(5);
  const auto points = Sample(Tilted(), 60'000, 10.0, 0.05, generator);
  const auto result = FitPlaneRansac(points, {});
  ASSERT_TRUE(result.ok()) << result.status();
  // Inliers come from all points: below the mean distance lie 57.5 % of a
  // normal distribution about the plane.
  EXPECT_GT(result->inliers.size(), 30'000U);
  // The round with most inliers is not the one with the least noise; the fit
  // to its inliers stays within the noise over the reach, 0.05 / 10.
  EXPECT_LT(AngleTo(result->plane, Tilted()), 5e-3);
}

}  // namespace
}  // namespace groundlock::geometry
