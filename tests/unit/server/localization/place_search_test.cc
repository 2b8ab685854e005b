// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/place_search.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <vector>

#include "map_store/map/landmark_index.h"
#include "tests/support/rendered_place_test.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using test_support::RenderedPlace;

class PlaceSearchTest : public test_support::RenderedPlaceTest {
 protected:
  static features::SiftFeatures FeaturesOf(const cv::Mat& luma) {
    features::SiftOptions options;
    options.max_features = 1'000;
    auto features = features::ExtractSift(luma, {}, options);
    EXPECT_TRUE(features.ok()) << features.status();
    return *std::move(features);
  }
  static std::vector<PlacePose> Find(const features::SiftFeatures& features) {
    return FindPlaces(*map_,
                      features,
                      place_->camera(),
                      std::vector<bool>(map_->num_views(), true),
                      PlaceSearchOptions());
  }
};

TEST_F(PlaceSearchTest, FindsThePlaceBestFirstAndNoOther) {
  const auto places = Find(FeaturesOf(place_->Render(truth_)));
  ASSERT_FALSE(places.empty());
  EXPECT_GT(places.front().num_inliers, 100);
  EXPECT_LT(test_support::CenterError(places.front().world_from_camera, truth_),
            0.2);
  EXPECT_TRUE(Find(FeaturesOf(RenderedPlace(2).Render(truth_))).empty());
  EXPECT_TRUE(Find(features::SiftFeatures()).empty());
}

TEST_F(PlaceSearchTest, AMirroredImageIsFoundByMirroredFeatures) {
  cv::Mat mirrored;
  cv::flip(place_->Render(truth_), mirrored, 1);
  const features::SiftFeatures features = FeaturesOf(mirrored);
  const auto places = Find(MirrorFeatures(features, mirrored.cols));
  ASSERT_FALSE(places.empty());
  // Some of what is drawn there is symmetric.
  for (const PlacePose& wrong : Find(features)) {
    EXPECT_LT(wrong.num_inliers, places.front().num_inliers / 2);
  }
  EXPECT_LT(test_support::CenterError(places.front().world_from_camera, truth_),
            0.2);
}

TEST_F(PlaceSearchTest, MirroredFeaturesAreThoseOfTheMirroredImage) {
  const cv::Mat luma = place_->Render(truth_);
  cv::Mat flipped;
  cv::flip(luma, flipped, 1);
  const features::SiftFeatures features = FeaturesOf(luma);
  const features::SiftFeatures expected = FeaturesOf(flipped);
  const features::SiftFeatures mirrored = MirrorFeatures(features, luma.cols);
  std::size_t equal = 0;
  for (std::size_t i = 0; i < mirrored.descriptors.size(); ++i) {
    for (std::size_t j = 0; j < expected.descriptors.size(); ++j) {
      const bool is_same =
          (mirrored.keypoints_px[i] - expected.keypoints_px[j]).norm() < 1.0 &&
          map::SquaredDistance(mirrored.descriptors[i],
                               expected.descriptors[j]) < 100 * 100;
      if (!is_same) continue;
      ++equal;
      break;
    }
  }
  // The others' order of strength differs, by rounding.
  EXPECT_GT(equal, mirrored.descriptors.size() * 8 / 10);
  const features::SiftFeatures twice = MirrorFeatures(mirrored, luma.cols);
  EXPECT_EQ(twice.descriptors, features.descriptors);
}

}  // namespace
}  // namespace groundlock::localization
