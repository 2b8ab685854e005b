// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/guided_matching.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "tests/support/rendered_plane_map.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using test_support::LookAlongY;
using test_support::MakeCamera;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

// Distance `distance` from the zero descriptor.
map::Descriptor At(std::uint8_t distance) {
  map::Descriptor descriptor{};
  descriptor[0] = distance;
  return descriptor;
}

// Far from everything else, in its own direction.
map::Descriptor Unlike(int index) {
  map::Descriptor descriptor{};
  descriptor[2 * index + 10] = 255;
  descriptor[2 * index + 11] = 255;
  return descriptor;
}

const Rigid3 kPose = LookAlongY({0.0, 0.0, 1.5}, 0.0, 0.0);

// A wall 5 m away with landmarks where kPose sees these pixels, in three views
// from there (or as many as given).
class Wall {
 public:
  void Add(const Eigen::Vector2d& pixel_px,
           const map::Descriptor& descriptor,
           int num_views = 3) {
    const Eigen::Vector2d xy = *camera_.NormalizedFromImage(pixel_px);
    const Eigen::Vector3d p_camera = 5.0 * xy.homogeneous();
    const auto id = static_cast<std::uint32_t>(data_.landmarks.size());
    data_.landmarks.push_back({kPose * p_camera, {}, 0.0F});
    for (int v = 0; v < num_views; ++v) {
      data_.views[v].keypoints_px.emplace_back(pixel_px.cast<float>());
      data_.views[v].landmarks.push_back(id);
      data_.views[v].descriptors.push_back(descriptor);
    }
  }
  Wall() {
    data_.source_format = "synthetic";
    data_.cameras.push_back(camera_);
    for (int v = 0; v < 3; ++v) {
      data_.views.push_back({.name = "view" + std::to_string(v),
                             .camera = 0,
                             .camera_from_world = kPose.Inverse(),
                             .keypoints_px = {},
                             .landmarks = {},
                             .descriptors = {}});
    }
  }

  std::vector<GuidedMatch> Match(
      const features::SiftFeatures& features,
      const GuidedMatchingOptions& options = {}) const {
    const auto map = test_support::OpenTemporaryMap(data_);
    EXPECT_NE(map, nullptr);
    return MatchGuided(*map, features, camera_, kPose, options);
  }

 private:
  geometry::CameraModel camera_ = MakeCamera();
  map::MapData data_;
};

std::vector<std::uint32_t> Landmarks(const std::vector<GuidedMatch>& matches) {
  std::vector<std::uint32_t> landmarks;
  for (const LandmarkMatch& match : matches) {
    landmarks.push_back(match.landmark);
  }
  return landmarks;
}

TEST(MatchGuided, FindsFeaturesWithinTheRadius) {
  Wall wall;
  wall.Add({300.0, 200.0}, Unlike(0));
  wall.Add({600.0, 200.0}, Unlike(1));
  wall.Add({900.0, 200.0}, Unlike(2));
  features::SiftFeatures features;
  features.keypoints_px = {{303.0, 204.0}, {609.0, 209.0}, {900.0, 187.9}};
  for (int i = 0; i < 3; ++i) features.descriptors.push_back(Unlike(i));
  // 5 px, 12.7 px, 12.1 px.
  const auto matches = wall.Match(features, {.radius_px = 12.0});
  ASSERT_THAT(Landmarks(matches), ElementsAre(0U));
  EXPECT_EQ(matches[0].pixel_px, features.keypoints_px[0]);
  EXPECT_THAT(Landmarks(wall.Match(features, {.radius_px = 12.5})),
              ElementsAre(0U, 2U));
  EXPECT_THAT(Landmarks(wall.Match(features, {.radius_px = 5'000.0})),
              ElementsAre(0U, 1U, 2U));
  EXPECT_THAT(Landmarks(wall.Match(features, {.radius_px = 4.9})), IsEmpty());
}

TEST(MatchGuided, LooksIntoTheImagesCorners) {
  Wall wall;
  const std::vector<Eigen::Vector2d> corners = {
      {1.0, 1.0}, {1279.0, 1.0}, {1.0, 719.0}, {1279.0, 719.0}};
  features::SiftFeatures features;
  for (int i = 0; i < 4; ++i) {
    wall.Add(corners[i], Unlike(i));
    // SIFT places features up to the very edge, and rounds beyond it.
    features.keypoints_px.emplace_back(corners[i].x() > 2.0 ? 1280.2 : -0.2,
                                       corners[i].y() > 2.0 ? 720.2 : -0.2);
    features.descriptors.push_back(Unlike(i));
  }
  EXPECT_THAT(Landmarks(wall.Match(features)), ElementsAre(0U, 1U, 2U, 3U));
}

TEST(MatchGuided, OneMatchPerFeatureAndLandmark) {
  Wall wall;
  // Both look like the one feature, the second more so.
  wall.Add({300.0, 200.0}, At(60));
  wall.Add({304.0, 200.0}, At(30));
  EXPECT_THAT(Landmarks(wall.Match({{{302.0, 200.0}}, {At(0)}})),
              ElementsAre(1U));
  // Two features at one spot (two orientations) are no rivals; the more alike
  // is taken.
  const auto matches =
      wall.Match({{{302.0, 200.0}, {302.3, 200.0}}, {At(24), At(31)}});
  ASSERT_THAT(Landmarks(matches), ElementsAre(1U));
  EXPECT_EQ(matches[0].pixel_px.x(), 302.3);
}

TEST(MatchGuided, RivalsNearbyMakeItAmbiguous) {
  Wall wall;
  wall.Add({300.0, 200.0}, At(0));
  // 80 / 100 passes a ratio of 0.85, 90 / 100 does not; in either order.
  EXPECT_THAT(wall.Match({{{298.0, 200.0}, {303.0, 200.0}}, {At(80), At(100)}}),
              testing::SizeIs(1));
  EXPECT_THAT(wall.Match({{{303.0, 200.0}, {298.0, 200.0}}, {At(100), At(80)}}),
              testing::SizeIs(1));
  EXPECT_THAT(wall.Match({{{298.0, 200.0}, {303.0, 200.0}}, {At(90), At(100)}}),
              IsEmpty());
  EXPECT_THAT(wall.Match({{{303.0, 200.0}, {298.0, 200.0}}, {At(100), At(90)}}),
              IsEmpty());
  // A rival outside the radius is none.
  EXPECT_THAT(wall.Match({{{298.0, 200.0}, {320.0, 200.0}}, {At(90), At(100)}}),
              testing::SizeIs(1));
}

TEST(MatchGuided, UnlikeFeaturesAreNotMatched) {
  Wall wall;
  wall.Add({300.0, 200.0}, At(0));
  EXPECT_THAT(wall.Match({{{300.0, 200.0}}, {At(200)}}), testing::SizeIs(1));
  EXPECT_THAT(wall.Match({{{300.0, 200.0}}, {At(200)}},
                         {.max_descriptor_distance = 199.0}),
              IsEmpty());
  // sqrt(2) 255 = 361.
  EXPECT_THAT(wall.Match({{{300.0, 200.0}}, {Unlike(0)}}), IsEmpty());
}

TEST(MatchGuided, LandmarksOfFewViewsAndBehindTheCameraAreLeftOut) {
  Wall wall;
  wall.Add({300.0, 200.0}, Unlike(0), /*num_views=*/2);
  wall.Add({600.0, 200.0}, Unlike(1));
  const features::SiftFeatures features{{{300.0, 200.0}, {600.0, 200.0}},
                                        {Unlike(0), Unlike(1)}};
  EXPECT_THAT(Landmarks(wall.Match(features)), ElementsAre(1U));
  EXPECT_THAT(Landmarks(wall.Match(features, {.min_landmark_views = 2})),
              ElementsAre(0U, 1U));
  EXPECT_THAT(wall.Match({}), IsEmpty());
}

TEST(NearbyViews, NearestThatFaceTheSameWay) {
  map::MapData data;
  data.source_format = "synthetic";
  data.cameras.push_back(MakeCamera());
  data.landmarks.push_back({{0.0, 5.0, 1.5}, {}, 0.0F});
  const std::vector<Rigid3> views = {
      LookAlongY({3.0, 0.0, 1.5}, 0.0, 0.0),
      LookAlongY({1.0, 0.0, 1.5}, 0.0, 0.0),
      LookAlongY({0.1, 0.0, 1.5}, M_PI, 0.0),        // looks back
      LookAlongY({0.1, 0.0, 1.5}, M_PI / 2.0, 0.0),  // looks aside
      LookAlongY({2.0, 0.0, 1.5}, 0.0, 0.0),
      // Turned by 55 degrees: 1.3 m count as 2.27 m.
      LookAlongY({1.3, 0.0, 1.5}, 55.0 / 180.0 * M_PI, 0.0)};
  for (std::size_t i = 0; i < views.size(); ++i) {
    data.views.push_back({.name = std::to_string(i),
                          .camera = 0,
                          .camera_from_world = views[i].Inverse(),
                          .keypoints_px = {{1.0F, 1.0F}},
                          .landmarks = {0},
                          .descriptors = {At(0)}});
  }
  const auto map = test_support::OpenTemporaryMap(data);
  ASSERT_NE(map, nullptr);
  EXPECT_THAT(NearbyViews(*map, kPose, 10), ElementsAre(1U, 4U, 5U, 0U));
  EXPECT_THAT(NearbyViews(*map, kPose, 2), ElementsAre(1U, 4U));
  EXPECT_THAT(NearbyViews(*map, kPose, 0), IsEmpty());
}

}  // namespace
}  // namespace groundlock::localization
