// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/triangulation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "map_store/build/internal/similarity_ransac.h"

namespace groundlock::build::internal {
namespace {

geometry::CameraModel Lens() {
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial,
      1'280,
      720,
      std::vector<double>{1'050.0, 640.0, 360.0, -0.045});
}

// Cameras in a row, 1 m apart, looking along z at a point 8 m away.
std::vector<Sight> Sights(const geometry::CameraModel& lens,
                          const Eigen::Vector3d& p_world,
                          int count) {
  std::vector<Sight> sights;
  for (int i = 0; i < count; ++i) {
    geometry::Rigid3 camera_from_world;
    camera_from_world.translation = {-1.0 * i, 0.1 * i, 0.0};
    sights.push_back({&lens,
                      camera_from_world,
                      *lens.ImageFromCamera(camera_from_world * p_world)});
  }
  return sights;
}

const Eigen::Vector3d kPoint(1.5, -0.4, 8.0);

TEST(Triangulate, RecoversAPointExactly) {
  const geometry::CameraModel lens = Lens();
  for (const int count : {2, 3, 20}) {
    const auto found =
        Triangulate(Sights(lens, kPoint, std::min(count, 5)), {});
    ASSERT_TRUE(found) << count;
    EXPECT_LT((found->p_world - kPoint).norm(), 1e-6);
    EXPECT_LT(found->mean_error_px, 1e-5);
  }
}

TEST(Triangulate, LeavesOutliersOut) {
  const geometry::CameraModel lens = Lens();
  std::vector<Sight> sights = Sights(lens, kPoint, 5);
  sights[1].pixel_px += Eigen::Vector2d(40.0, -25.0);
  sights[4].pixel_px += Eigen::Vector2d(-60.0, 10.0);
  const auto found = Triangulate(sights, {});
  ASSERT_TRUE(found);
  EXPECT_THAT(found->is_inlier,
              ::testing::ElementsAre(true, false, true, true, false));
  EXPECT_LT((found->p_world - kPoint).norm(), 1e-6);
}

TEST(Triangulate, RefusesNarrowAnglesPointsBehindAndDisagreement) {
  const geometry::CameraModel lens = Lens();
  EXPECT_FALSE(Triangulate(Sights(lens, {0.0, 0.0, 300.0}, 2), {}));
  EXPECT_FALSE(Triangulate(Sights(lens, kPoint, 1), {}));
  std::vector<Sight> sights = Sights(lens, kPoint, 2);
  std::swap(sights[0].pixel_px, sights[1].pixel_px);  // diverging rays
  EXPECT_FALSE(Triangulate(sights, {}));
}

TEST(EpipolarDistance, IsZeroOnTheLineAndGrowsAcross) {
  const geometry::Rigid3 camera2_from_camera1 = {
      geometry::QuaternionFromRotationVector({0.02, -0.1, 0.03}),
      {-1.0, 0.05, 0.1}};
  const Eigen::Vector3d ray1 = (kPoint / kPoint.z()).eval();
  const Eigen::Vector3d p2 = camera2_from_camera1 * kPoint;
  const Eigen::Vector3d ray2 = p2 / p2.z();
  EXPECT_NEAR(EpipolarDistance_px(camera2_from_camera1, ray1, ray2, 1'000.0),
              0.0,
              1e-9);
  // The line is nearly horizontal: 5 px up are nearly 5 px away.
  const Eigen::Vector3d off = ray2 + Eigen::Vector3d(0.0, 0.005, 0.0);
  EXPECT_NEAR(
      EpipolarDistance_px(camera2_from_camera1, ray1, off, 1'000.0), 5.0, 0.2);
}

class SimilarityRansac : public ::testing::Test {
 protected:
  SimilarityRansac() {
    truth_.scale = 2.4;
    truth_.rotation = geometry::QuaternionFromRotationVector({0.3, -1.2, 0.7});
    truth_.translation = {4.0, -2.0, 11.0};
  }
  std::vector<PointPair> Pairs(int count, double outliers, double noise) const {
    std::mt19937_64 engine(5);
    std::uniform_real_distribution<double> place(-5.0, 5.0);
    std::normal_distribution<double> error(0.0, 1.0);
    std::vector<PointPair> pairs;
    const auto draw = [&](auto& distribution) {
      return Eigen::Vector3d{
          distribution(engine), distribution(engine), distribution(engine)};
    };
    for (int i = 0; i < count; ++i) {
      PointPair pair;
      pair.p_source = draw(place);
      pair.p_target =
          i < outliers * count
              ? Eigen::Vector3d(3.0 * draw(place))
              : Eigen::Vector3d(truth_ * pair.p_source + noise * draw(error));
      pairs.push_back(pair);
    }
    return pairs;
  }
  static PairError Distance(const std::vector<PointPair>& pairs) {
    return [&pairs](std::size_t i, const Eigen::Vector3d& p_target) {
      return (pairs[i].p_target - p_target).norm();
    };
  }
  geometry::Similarity3 truth_;
};

TEST_F(SimilarityRansac, FindsTheTransformAmongOutliers) {
  const auto pairs = Pairs(300, 0.7, 0.01);
  SimilarityRansacOptions options;
  options.max_error = 0.08;
  const auto found = EstimateSimilarityRansac(pairs, Distance(pairs), options);
  ASSERT_TRUE(found);
  EXPECT_GE(found->num_inliers, 88);  // of 90
  EXPECT_LE(found->num_inliers, 92);
  EXPECT_NEAR(found->target_from_source.scale, truth_.scale, 2e-3);
  EXPECT_LT(geometry::AngleBetween_rad(found->target_from_source.rotation,
                                       truth_.rotation),
            1e-3);
  EXPECT_LT((found->target_from_source.translation - truth_.translation).norm(),
            0.01);
}

TEST_F(SimilarityRansac, IsDeterministicAndRefusesNoise) {
  const auto pairs = Pairs(200, 0.5, 0.01);
  SimilarityRansacOptions options;
  options.max_error = 0.08;
  const auto first = EstimateSimilarityRansac(pairs, Distance(pairs), options);
  const auto second = EstimateSimilarityRansac(pairs, Distance(pairs), options);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->target_from_source.translation,
            second->target_from_source.translation);
  const auto noise = Pairs(100, 1.0, 0.0);
  options.max_iterations = 500;
  EXPECT_FALSE(EstimateSimilarityRansac(noise, Distance(noise), options));
  EXPECT_FALSE(EstimateSimilarityRansac({}, Distance(noise), options));
}

}  // namespace
}  // namespace groundlock::build::internal
