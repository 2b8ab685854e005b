// SPDX-License-Identifier: Apache-2.0
// Posed images to a map, extending it and merging two, on rendered images of a
// made-up place: true poses and real features.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "map_store/base/file.h"
#include "map_store/build/grow.h"
#include "map_store/build/posed.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;

class Growing : public ::testing::Test {
 protected:
  // Renders views [begin, end) of the place into a folder of their own.
  PosedOptions Photos(const std::string& folder, int begin, int end) const {
    PosedOptions options;
    options.images = directory_.path() / folder;
    options.camera = place_.camera();
    options.max_features = 1'500;
    options.threads = 2;
    fs::create_directories(options.images);
    const auto views = test_support::MappingViews();
    for (int i = begin; i < end; ++i) {
      PosedImage image;
      image.name = "view" + std::to_string(i) + ".png";
      image.world_from_camera = views[static_cast<std::size_t>(i)];
      cv::imwrite((options.images / image.name).string(),
                  place_.Render(image.world_from_camera));
      options.poses.push_back(image);
    }
    return options;
  }

  // How far a map's cameras are from the truth, at most.
  static double WorstCenter(const map::MapData& data) {
    const auto truth = test_support::MappingViews();
    double worst = 0.0;
    for (const map::MapViewData& view : data.views) {
      const auto number =
          static_cast<std::size_t>(view.name[view.name.find("view") + 4] - '0');
      worst = std::max(worst,
                       (view.camera_from_world.Inverse().translation -
                        truth[number].translation)
                           .norm());
    }
    return worst;
  }

  const test_support::RenderedPlace place_{11};

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

TEST_F(Growing, KnownPosesGiveLandmarksOnTheSurfaces) {
  const auto built = BuildFromPoses(Photos("all", 0, 4), nullptr);
  ASSERT_TRUE(built.ok()) << built.status();
  EXPECT_TRUE(built->data.Validate().ok());
  EXPECT_EQ(built->report.num_registered, 4);
  ASSERT_GT(built->data.landmarks.size(), 300U);
  EXPECT_LT(built->report.mean_reprojection_error_px, 0.6);
  // Fixed poses stay as they are, to rounding.
  EXPECT_LT(WorstCenter(built->data), 1e-9);
  // Landmarks lie where their pixels hit the panels.
  std::vector<double> errors;
  const map::MapViewData& view = built->data.views[1];
  for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
    const auto hit = place_.Intersect(view.camera_from_world.Inverse(),
                                      view.keypoints_px[i].cast<double>());
    if (!hit) continue;
    errors.push_back(
        (hit->p_world - built->data.landmarks[view.landmarks[i]].p_world)
            .norm());
  }
  ASSERT_GT(errors.size(), 100U);
  std::sort(errors.begin(), errors.end());
  // 9 m away with 0.6 m between views, 0.3 px are some 5 cm of depth.
  EXPECT_LT(errors[errors.size() / 2], 0.05);
}

TEST_F(Growing, RoughPosesAreImproved) {
  PosedOptions options = Photos("rough", 0, 4);
  for (std::size_t i = 0; i < options.poses.size(); ++i) {
    geometry::Rigid3& pose = options.poses[i].world_from_camera;
    const double sign = i % 2 == 0 ? 1.0 : -1.0;
    pose.translation += sign * Eigen::Vector3d(0.0, 0.02, -0.02);
    pose.rotation = geometry::QuaternionFromRotationVector(
                        {sign * 0.003, 0.0, sign * 0.002}) *
                    pose.rotation;
  }
  options.sigma_m = 0.03;
  options.sigma_rad = 0.005;
  const auto built = BuildFromPoses(options, nullptr);
  ASSERT_TRUE(built.ok()) << built.status();
  EXPECT_LT(built->report.mean_reprojection_error_px, 0.6);
}

TEST_F(Growing, WrongPosesAreRefused) {
  PosedOptions options = Photos("wrong", 0, 2);
  options.poses[1].world_from_camera =
      test_support::LookAlongY({0.0, 0.0, 9.0}, 0.4, 0.4);
  EXPECT_EQ(BuildFromPoses(options, nullptr).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(Growing, NewImagesFindTheirPlaceAndAddLandmarks) {
  auto built = BuildFromPoses(Photos("old", 0, 4), nullptr);
  ASSERT_TRUE(built.ok()) << built.status();
  const std::size_t before = built->data.landmarks.size();
  ExtendOptions options;
  options.images = Photos("new", 4, 7).images;
  options.max_features = 1'500;
  options.threads = 2;
  const auto report = ExtendMap(options, nullptr, &built->data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->registered.size(), 3U);
  EXPECT_GT(report->num_new_landmarks, 50U);
  EXPECT_GT(report->num_new_observations, 100U);
  EXPECT_TRUE(built->data.Validate().ok());
  EXPECT_EQ(built->data.views.size(), 7U);
  EXPECT_GT(built->data.landmarks.size(), before);
  EXPECT_LT(WorstCenter(built->data), 0.03);
  // The same images a second time are a mistake.
  EXPECT_EQ(ExtendMap(options, nullptr, &built->data).status().code(),
            absl::StatusCode::kAlreadyExists);
}

TEST_F(Growing, ImagesOfAnotherPlaceFindNone) {
  auto built = BuildFromPoses(Photos("old", 0, 3), nullptr);
  ASSERT_TRUE(built.ok()) << built.status();
  ExtendOptions options;
  options.images = Photos("elsewhere", 0, 0).images;
  options.max_features = 1'500;
  const test_support::RenderedPlace other(99);
  cv::imwrite((options.images / "other.png").string(),
              other.Render(test_support::MappingViews()[1]));
  EXPECT_EQ(ExtendMap(options, nullptr, &built->data).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(Growing, TwoMapsBecomeOneInTheFirstsWorld) {
  auto first = BuildFromPoses(Photos("first", 0, 4), nullptr);
  auto second = BuildFromPoses(Photos("second", 3, 7), nullptr);
  ASSERT_TRUE(first.ok() && second.ok());
  geometry::Similarity3 elsewhere;
  elsewhere.scale = 0.37;
  elsewhere.rotation = geometry::QuaternionFromRotationVector({0.4, -0.9, 1.3});
  elsewhere.translation = {5.0, 1.0, -7.0};
  second->data.Transform(elsewhere);
  const std::size_t separate =
      first->data.landmarks.size() + second->data.landmarks.size();
  MergeOptions options;
  options.threads = 2;
  const auto report = MergeMaps(second->data, options, nullptr, &first->data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_GT(report->num_common_landmarks, 60);
  EXPECT_LT(report->median_error_px, 2.0);
  EXPECT_NEAR(report->first_from_second.scale, 1.0 / 0.37, 0.02);
  EXPECT_TRUE(first->data.Validate().ok());
  EXPECT_EQ(first->data.views.size(), 8U);
  EXPECT_LT(first->data.landmarks.size(), separate);
  EXPECT_LT(WorstCenter(first->data), 0.05);
}

TEST_F(Growing, MapsOfDifferentPlacesAreNotMerged) {
  auto first = BuildFromPoses(Photos("first", 0, 3), nullptr);
  ASSERT_TRUE(first.ok()) << first.status();
  const map::MapData second = test_support::MapFromViews(
      test_support::RenderedPlace(99), test_support::MappingViews());
  EXPECT_EQ(MergeMaps(second, {}, nullptr, &first->data).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace groundlock::build
