// SPDX-License-Identifier: Apache-2.0
// Rigid and similarity transforms, boxes.
#include <gtest/gtest.h>

#include <numbers>
#include <random>

#include "map_store/geometry/box.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::geometry {
namespace {

Eigen::Vector3d RandomVector(std::mt19937_64& generator) {
  std::normal_distribution<double> normal(0.0, 2.0);
  return {normal(generator), normal(generator), normal(generator)};
}

Rigid3 RandomRigid(std::mt19937_64& generator) {
  const Eigen::Vector3d rotation = RandomVector(generator);
  return {QuaternionFromRotationVector(rotation), RandomVector(generator)};
}

Similarity3 RandomSimilarity(std::mt19937_64& generator) {
  const Rigid3 rigid = RandomRigid(generator);
  return {std::exp(0.5 * RandomVector(generator).x()),
          rigid.rotation,
          rigid.translation};
}

TEST(Rigid3Test, ComposesAndInverts) {
  std::mt19937_64 generator(1);
  for (int i = 0; i < 100; ++i) {
    const Rigid3 c_from_b = RandomRigid(generator);
    const Rigid3 b_from_a = RandomRigid(generator);
    const Eigen::Vector3d p_a = RandomVector(generator);
    EXPECT_LT((c_from_b * b_from_a * p_a - c_from_b * (b_from_a * p_a)).norm(),
              1e-12);
    EXPECT_LT((b_from_a.Inverse() * (b_from_a * p_a) - p_a).norm(), 1e-12);
    EXPECT_LT(
        (b_from_a.Matrix3x4() * p_a.homogeneous() - b_from_a * p_a).norm(),
        1e-12);
  }
}

TEST(Rigid3Test, RotationVectorRoundTrip) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 0.5).normalized();
  for (const double angle : {0.0, 1e-12, 1e-8, 1e-4, 1.0, 3.0, 3.14159}) {
    const Eigen::Vector3d v = angle * axis;
    const Eigen::Quaterniond q = QuaternionFromRotationVector(v);
    EXPECT_LT((RotationVector(q) - v).norm(), 1e-14 + 1e-12 * angle) << angle;
    // The same rotation, written with the other sign.
    const Eigen::Quaterniond minus(-q.w(), -q.x(), -q.y(), -q.z());
    EXPECT_LT((RotationVector(minus) - v).norm(), 1e-14 + 1e-12 * angle);
    EXPECT_NEAR(
        AngleBetween_rad(Eigen::Quaterniond::Identity(), minus), angle, 1e-12);
  }
  EXPECT_NEAR(RotationVector(QuaternionFromRotationVector(4.0 * axis)).norm(),
              2.0 * std::numbers::pi - 4.0,
              1e-12);
}

TEST(Rigid3Test, SkewIsTheCrossProduct) {
  const Eigen::Vector3d a(1, 2, 3);
  const Eigen::Vector3d b(-4, 5, 0.5);
  EXPECT_LT((Skew(a) * b - a.cross(b)).norm(), 1e-15);
}

TEST(Similarity3Test, ComposesAndInverts) {
  std::mt19937_64 generator(2);
  for (int i = 0; i < 100; ++i) {
    const Similarity3 c_from_b = RandomSimilarity(generator);
    const Similarity3 b_from_a = RandomSimilarity(generator);
    const Eigen::Vector3d p = RandomVector(generator);
    const double size = 1.0 + (c_from_b * (b_from_a * p)).norm();
    EXPECT_LT((c_from_b * b_from_a * p - c_from_b * (b_from_a * p)).norm(),
              1e-12 * size);
    EXPECT_LT((b_from_a.Inverse() * (b_from_a * p) - p).norm(),
              1e-11 * (1.0 + p.norm()) * (1.0 + 1.0 / b_from_a.scale));
  }
}

TEST(Similarity3Test, MovedCameraSeesTheSameDirections) {
  std::mt19937_64 generator(3);
  const Similarity3 target_from_source = RandomSimilarity(generator);
  const Rigid3 camera_from_source = RandomRigid(generator);
  const Rigid3 camera_from_target =
      TransformCameraFromWorld(target_from_source, camera_from_source);
  const Eigen::Vector3d p = RandomVector(generator);
  EXPECT_LT((camera_from_target * (target_from_source * p) -
             target_from_source.scale * (camera_from_source * p))
                .norm(),
            1e-11);
  EXPECT_LT((camera_from_target.Inverse().translation -
             target_from_source * camera_from_source.Inverse().translation)
                .norm(),
            1e-11);
}

TEST(Similarity3Test, EstimateRecoversExactly) {
  std::mt19937_64 generator(4);
  for (const int count : {3, 4, 50}) {
    const Similarity3 truth = RandomSimilarity(generator);
    std::vector<Eigen::Vector3d> source;
    std::vector<Eigen::Vector3d> target;
    for (int i = 0; i < count; ++i) {
      source.push_back(RandomVector(generator));
      target.push_back(truth * source.back());
    }
    const auto found = EstimateSimilarity(source, target);
    ASSERT_TRUE(found.ok()) << found.status();
    EXPECT_NEAR(found->scale / truth.scale, 1.0, 1e-10);
    EXPECT_LT(AngleBetween_rad(found->rotation, truth.rotation), 1e-10);
    EXPECT_LT((found->translation - truth.translation).norm(),
              1e-9 * (1.0 + truth.scale));
  }
}

TEST(Similarity3Test, EstimateRefusesDegeneratePoints) {
  const std::vector<Eigen::Vector3d> line = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  const std::vector<Eigen::Vector3d> good = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  EXPECT_EQ(EstimateSimilarity(line, good).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(EstimateSimilarity(good, line).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(EstimateSimilarity(good, std::span(good).first(2)).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(EstimateSimilarity({}, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(Box2Test, IntersectionOverUnion) {
  const Box2 a = Box2::FromXywh(0, 0, 10, 10);
  EXPECT_DOUBLE_EQ(IntersectionOverUnion(a, a), 1.0);
  EXPECT_DOUBLE_EQ(IntersectionOverUnion(a, Box2::FromXywh(5, 0, 10, 10)),
                   1.0 / 3.0);
  EXPECT_DOUBLE_EQ(IntersectionOverUnion(a, Box2::FromXywh(20, 20, 5, 5)), 0.0);
  EXPECT_DOUBLE_EQ(Intersection(a, Box2::FromXywh(20, 0, 5, 5)).Area(), 0.0);
  EXPECT_DOUBLE_EQ(IntersectionOverUnion(Box2{}, Box2{}), 0.0);
  EXPECT_DOUBLE_EQ(Box2::FromXywh(0, 0, -3, -4).Area(), 0.0);
  EXPECT_TRUE(a.Contains({0, 0}));
  EXPECT_FALSE(a.Contains({10, 5}));
}

TEST(Box3Test, CornersFollowTheBits) {
  Box3 box;
  box.world_from_object.rotation =
      Eigen::AngleAxisd(std::numbers::pi / 2.0, Eigen::Vector3d::UnitZ());
  box.world_from_object.translation = {10, 20, 1};
  box.size_m = {4, 2, 2};
  const auto corners = box.CornersWorld();
  // Heading along world y: length extends in y, the left side is -x.
  EXPECT_LT((corners[0] - Eigen::Vector3d(11, 18, 0)).norm(), 1e-12);
  EXPECT_LT((corners[7] - Eigen::Vector3d(9, 22, 2)).norm(), 1e-12);
  EXPECT_LT((corners[1] - Eigen::Vector3d(11, 22, 0)).norm(), 1e-12);
  EXPECT_LT((box.BottomCenterWorld() - Eigen::Vector3d(10, 20, 0)).norm(),
            1e-12);
}

}  // namespace
}  // namespace groundlock::geometry
