// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchoring.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <utility>
#include <vector>

#include "tests/support/perturbation.h"
#include "tests/support/rendered_place_test.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::LookAlongY;
using test_support::RenderedPlace;

// About 300 inliers with 0.5 px at 6 to 9 m: the centre is known to a few
// millimetres. Three times that.
constexpr double kCenter_m = 0.015;
constexpr double kAngle_rad = 0.002;

class AnchoringTest : public test_support::RenderedPlaceTest {
 protected:
  static AnchorRequest RequestOf(const cv::Mat& luma) {
    AnchorRequest request;
    request.luma = luma;
    request.camera = place_->camera();
    request.seed = test_support::PerturbedSeed(7);
    return request;
  }
  static void ExpectNear(const Anchor& anchor, const Rigid3& truth) {
    EXPECT_LT(CenterError(anchor.pose.world_from_camera, truth), kCenter_m);
    EXPECT_LT(AngleError_rad(anchor.pose.world_from_camera, truth), kAngle_rad);
    EXPECT_EQ(anchor.inliers.size(),
              static_cast<std::size_t>(anchor.pose.num_inliers));
  }
};

TEST_F(AnchoringTest, APoseByOtherSensorsIsASearchAroundIt) {
  AnchorRequest request = RequestOf(place_->Render(truth_));
  PosePrior prior;
  prior.position_world = truth_.translation + Eigen::Vector3d(0.3, -0.2, 0.1);
  prior.position_sigma = 0.3;
  request.prior = prior;
  const auto by_position = FindAnchor(*map_, request, AnchorOptions());
  ASSERT_TRUE(by_position);
  EXPECT_FALSE(by_position->used_prior);
  ExpectNear(*by_position, truth_);
  // Three degrees off.
  prior.rotation = geometry::QuaternionFromRotationVector({0.0, 0.0, 0.05}) *
                   truth_.rotation;
  prior.rotation_sigma_rad = 0.05;
  request.prior = prior;
  const auto by_pose = FindAnchor(*map_, request, AnchorOptions());
  ASSERT_TRUE(by_pose);
  EXPECT_TRUE(by_pose->used_prior);
  ExpectNear(*by_pose, truth_);
  // A wrong one costs time alone.
  prior.position_world = Eigen::Vector3d(30.0, 50.0, 0.0);
  prior.rotation = Eigen::Quaterniond::Identity();
  request.prior = prior;
  const auto despite = FindAnchor(*map_, request, AnchorOptions());
  ASSERT_TRUE(despite);
  EXPECT_FALSE(despite->used_prior);
  ExpectNear(*despite, truth_);
}

TEST_F(AnchoringTest, FindsTheCameraFromNothing) {
  const auto anchor =
      FindAnchor(*map_, RequestOf(place_->Render(truth_)), AnchorOptions());
  ASSERT_TRUE(anchor);
  EXPECT_FALSE(anchor->used_prior);
  ExpectNear(*anchor, truth_);
}

TEST_F(AnchoringTest, TwoRunsAreEqual) {
  const AnchorRequest request = RequestOf(place_->Render(truth_));
  const auto one = FindAnchor(*map_, request, AnchorOptions());
  const auto two = FindAnchor(*map_, request, AnchorOptions());
  ASSERT_TRUE(one && two);
  EXPECT_EQ(one->pose.world_from_camera.translation,
            two->pose.world_from_camera.translation);
  EXPECT_EQ(one->pose.covariance, two->pose.covariance);
  ASSERT_EQ(one->inliers.size(), two->inliers.size());
  for (std::size_t i = 0; i < one->inliers.size(); ++i) {
    EXPECT_EQ(one->inliers[i].landmark, two->inliers[i].landmark);
  }
}

TEST_F(AnchoringTest, UsesAGoodPriorAndSurvivesWrongOnes) {
  AnchorRequest request = RequestOf(place_->Render(truth_));
  // 0.02 rad = 10 px.
  request.prior_world_from_camera = LookAlongY({0.37, 0.28, 1.7}, 0.07, -0.05);
  const auto with_prior = FindAnchor(*map_, request, AnchorOptions());
  ASSERT_TRUE(with_prior);
  EXPECT_TRUE(with_prior->used_prior);
  ExpectNear(*with_prior, truth_);

  for (const Rigid3& wrong : {LookAlongY({-1.5, -1.0, 1.2}, -0.4, 0.2),
                              LookAlongY({0.3, 30.0, 1.7}, 3.0, 0.0),
                              LookAlongY({1e6, -1e6, 0.0}, 0.0, 0.0)}) {
    request.prior_world_from_camera = wrong;
    const auto anchor = FindAnchor(*map_, request, AnchorOptions());
    ASSERT_TRUE(anchor);
    EXPECT_FALSE(anchor->used_prior);
    ExpectNear(*anchor, truth_);
  }
}

TEST_F(AnchoringTest, NothingElseIsThisPlace) {
  const cv::Mat luma = place_->Render(truth_);
  cv::Mat mirrored;
  cv::flip(luma, mirrored, 1);
  cv::Mat upside_down_mirrored;
  cv::flip(luma, upside_down_mirrored, 0);
  cv::Mat noise(luma.size(), CV_8UC1);
  std::mt19937 engine(3);
  for (int y = 0; y < noise.rows; ++y) {
    for (int x = 0; x < noise.cols; ++x) {
      noise.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(engine());
    }
  }
  const cv::Mat black(luma.size(), CV_8UC1, cv::Scalar(0));
  const cv::Mat elsewhere = RenderedPlace(2).Render(truth_);
  const std::pair<const char*, const cv::Mat&> images[] = {
      {"mirrored", mirrored},
      {"upside down, mirrored", upside_down_mirrored},
      {"noise", noise},
      {"black", black},
      {"elsewhere", elsewhere}};
  for (const auto& [name, image] : images) {
    AnchorRequest request = RequestOf(image);
    EXPECT_FALSE(FindAnchor(*map_, request, AnchorOptions())) << name;
    // Even if one believes to be there.
    request.prior_world_from_camera = truth_;
    EXPECT_FALSE(FindAnchor(*map_, request, AnchorOptions())) << name;
  }
  // An empty image is an answer, not a crash.
  EXPECT_FALSE(FindAnchor(*map_, RequestOf(cv::Mat()), AnchorOptions()));
}

TEST_F(AnchoringTest, LeavesOutMasks) {
  AnchorRequest request = RequestOf(place_->Render(truth_));
  request.masks_px.push_back(
      geometry::Box2::FromXywh(200.0, 100.0, 240.0, 200.0));
  for (const bool with_prior : {false, true}) {
    if (with_prior) request.prior_world_from_camera = truth_;
    const auto anchor = FindAnchor(*map_, request, AnchorOptions());
    ASSERT_TRUE(anchor);
    ExpectNear(*anchor, truth_);
    // SIFT's mask holds whole pixels.
    const auto inside = geometry::Box2::FromXywh(201.0, 101.0, 238.0, 198.0);
    for (const LandmarkMatch& match : anchor->inliers) {
      EXPECT_FALSE(inside.Contains(match.pixel_px));
    }
  }
  // Nothing is left to look at.
  request.masks_px = {geometry::Box2::FromXywh(-1.0, -1.0, 700.0, 400.0)};
  EXPECT_FALSE(FindAnchor(*map_, request, AnchorOptions()));
}

TEST_F(AnchoringTest, WhatLiesInOneCornerIsNotEnough) {
  const AnchorRequest request = RequestOf(place_->Render(truth_));
  // All matches in a narrow window: 4 x 4 squares of 16 px.
  AnchorRequest narrow = request;
  narrow.masks_px = {geometry::Box2::FromXywh(-1.0, -1.0, 289.0, 400.0),
                     geometry::Box2::FromXywh(352.0, -1.0, 300.0, 400.0),
                     geometry::Box2::FromXywh(-1.0, -1.0, 700.0, 145.0),
                     geometry::Box2::FromXywh(-1.0, 208.0, 700.0, 200.0)};
  narrow.prior_world_from_camera = truth_;
  EXPECT_FALSE(FindAnchor(*map_, narrow, AnchorOptions()));
}

// Something large that is not in the map hides more than half of the image, and
// nobody has told where.
TEST_F(AnchoringTest, AnOccluderDoesNotSpeakAgainstThePlace) {
  cv::Mat luma = place_->Render(truth_);
  const cv::Mat other = RenderedPlace(2).Render(truth_);
  const cv::Rect hidden(0, 0, 3 * luma.cols / 5, luma.rows);
  other(hidden).copyTo(luma(hidden));
  const auto anchor = FindAnchor(*map_, RequestOf(luma), AnchorOptions());
  ASSERT_TRUE(anchor);
  EXPECT_LT(CenterError(anchor->pose.world_from_camera, truth_),
            3.0 * kCenter_m);
}

TEST_F(AnchoringTest, PhotographsAreLookedAtCloser) {
  AnchorOptions closer;
  closer.is_photograph = true;
  const auto center_of = [&](const AnchorRequest& request,
                             const AnchorOptions& options) {
    const auto anchor = FindAnchor(*map_, request, options);
    EXPECT_TRUE(anchor);
    if (!anchor) return Eigen::Vector3d(0.0, 0.0, 0.0);
    ExpectNear(*anchor, truth_);
    return anchor->pose.world_from_camera.translation;
  };
  AnchorRequest small = RequestOf(place_->Render(truth_));
  // There is no more to it than what is looked at anyway.
  EXPECT_EQ(center_of(small, closer), center_of(small, AnchorOptions()));
  AnchorRequest large = small;
  large.camera = place_->camera().Rescaled(1600, 900);
  cv::resize(small.luma, large.luma, {1600, 900}, 0.0, 0.0, cv::INTER_LANCZOS4);
  EXPECT_NE(center_of(large, closer), center_of(large, AnchorOptions()));
}

}  // namespace
}  // namespace groundlock::localization
