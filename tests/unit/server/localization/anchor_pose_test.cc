// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchor_pose.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "server/localization/search/landmark_uncertainty.h"
#include "server/localization/solvers/pose_estimate.h"
#include "tests/support/rendered_place_test.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using geometry::Vector6d;

class AnchorPoseTest : public test_support::RenderedPlaceTest {
 protected:
  // Landmarks where they would be seen if every one lay elsewhere by an error
  // of its own, `errors` of its standard deviations, plus noise.
  std::vector<LandmarkMatch> See(const std::vector<Eigen::Vector3d>& errors,
                                 double noise_px,
                                 std::mt19937_64& engine) const {
    std::normal_distribution<double> normal;
    std::vector<LandmarkMatch> matches;
    for (std::uint32_t i = 0; i < map_->landmarks().size(); ++i) {
      const map::Landmark& landmark = map_->landmarks()[i];
      if (landmark.num_observations < 3) continue;
      const Eigen::Matrix3d L = LandmarkCovariance(*map_, i).llt().matrixL();
      const auto pixel = place_->camera().ImageFromCamera(
          truth_.Inverse() * (landmark.Position() + L * errors[i]));
      if (!pixel || !place_->camera().IsInsideImage(*pixel)) continue;
      matches.push_back({i,
                         *pixel + noise_px * Eigen::Vector2d{normal(engine),
                                                             normal(engine)}});
    }
    return matches;
  }
  std::vector<Eigen::Vector3d> Draw(std::mt19937_64& engine) const {
    std::normal_distribution<double> normal;
    std::vector<Eigen::Vector3d> errors;
    for (std::size_t i = 0; i < map_->landmarks().size(); ++i) {
      errors.push_back(
          Eigen::Vector3d{normal(engine), normal(engine), normal(engine)});
    }
    return errors;
  }
};

TEST_F(AnchorPoseTest, LandmarksSeenFromAfarAreUncertainInDepth) {
  for (const map::Landmark& landmark : map_->landmarks()) {
    const auto index =
        static_cast<std::uint32_t>(&landmark - map_->landmarks().data());
    const Eigen::Matrix3d covariance = LandmarkCovariance(*map_, index);
    ASSERT_TRUE(covariance.allFinite());
    ASSERT_GT(covariance.diagonal().minCoeff(), 0.0);
    if (landmark.num_observations < 3) continue;
    // The views look along +y.
    EXPECT_GT(covariance(1, 1), covariance(0, 0));
  }
}

// Errors as large as is said, over many draws of landmarks and noise.
TEST_F(AnchorPoseTest, CovarianceIsHonest) {
  std::mt19937_64 engine(5);
  constexpr int kRuns = 60;
  double sum = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    const auto matches = See(Draw(engine), 0.5, engine);
    ASSERT_GT(matches.size(), 100U);
    const auto anchor =
        RefineAnchorPose(*map_, place_->camera(), matches, truth_);
    ASSERT_TRUE(anchor);
    const Vector6d error =
        PoseDifference(anchor->measured.world_from_camera, truth_);
    const geometry::Matrix6d covariance =
        anchor->measured.random + anchor->measured.systematic;
    sum += error.dot(covariance.ldlt().solve(error));
  }
  // It leaves room for what is not drawn here: dependent matches, a bent map.
  EXPECT_GT(sum / kRuns, 0.5);
  EXPECT_LT(sum / kRuns, 7.0);
}

// The same landmarks, seen again: what comes back is the systematic part. Over
// many draws, since in one of them it may happen to be small.
TEST_F(AnchorPoseTest, WhatComesBackIsSystematic) {
  std::mt19937_64 engine(6);
  constexpr int kDraws = 20;
  double between = 0.0;     // squared, m^2
  double from_truth = 0.0;  // likewise
  for (int draw = 0; draw < kDraws; ++draw) {
    const auto errors = Draw(engine);
    const auto one = RefineAnchorPose(
        *map_, place_->camera(), See(errors, 0.1, engine), truth_);
    const auto two = RefineAnchorPose(
        *map_, place_->camera(), See(errors, 0.1, engine), truth_);
    ASSERT_TRUE(one && two);
    between += (one->measured.world_from_camera.translation -
                two->measured.world_from_camera.translation)
                   .squaredNorm();
    from_truth +=
        (one->measured.world_from_camera.translation - truth_.translation)
            .squaredNorm();
    EXPECT_GT(one->measured.systematic(0, 0), one->measured.random(0, 0));
  }
  EXPECT_LT(between, from_truth);
}

TEST_F(AnchorPoseTest, SharedLandmarksAreAShareOfTheLargerSet) {
  const std::vector<std::uint32_t> a = {1, 3, 5, 7};
  const std::vector<std::uint32_t> b = {3, 4, 7};
  EXPECT_DOUBLE_EQ(SharedLandmarks(a, b), 0.5);
  EXPECT_DOUBLE_EQ(SharedLandmarks(b, a), 0.5);
  EXPECT_DOUBLE_EQ(SharedLandmarks(a, a), 1.0);
  EXPECT_DOUBLE_EQ(SharedLandmarks(a, {}), 0.0);
  const std::vector<LandmarkMatch> matches = {{9, {}}, {2, {}}, {4, {}}};
  EXPECT_EQ(LandmarksOf(matches), (std::vector<std::uint32_t>{2, 4, 9}));
}

TEST_F(AnchorPoseTest, TooFewMatchesAreNoPose) {
  EXPECT_FALSE(RefineAnchorPose(*map_, place_->camera(), {}, truth_));
}

}  // namespace
}  // namespace groundlock::localization
