// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/feature_tracks.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace groundlock::build::internal {
namespace {

constexpr int kWidth_px = 640;
constexpr int kHeight_px = 360;
constexpr int kKeyframes = 20;

// A picture much larger than the camera's, with detail at all sizes.
cv::Mat Ground() {
  cv::Mat picture = cv::Mat::zeros(2'400, 4'000, CV_32FC1);
  cv::RNG random(5);
  for (int size = 2; size < picture.rows; size *= 2) {
    cv::Mat noise(picture.rows / size + 2, picture.cols / size + 2, CV_32FC1);
    random.fill(noise, cv::RNG::UNIFORM, -20.0, 20.0);
    cv::resize(noise, noise, picture.size(), 0.0, 0.0, cv::INTER_CUBIC);
    picture += noise;
  }
  cv::Mat luma;
  picture.convertTo(luma, CV_8UC1, 1.0, 128.0);
  return luma;
}

// As a camera sees it that flies away from it.
cv::Mat SeenFrom(const cv::Mat& ground, double scale) {
  cv::Mat small;
  cv::resize(ground, small, {}, scale, scale, cv::INTER_AREA);
  return small(cv::Rect((small.cols - kWidth_px) / 2,
                        (small.rows - kHeight_px) / 2,
                        kWidth_px,
                        kHeight_px))
      .clone();
}

TEST(TrackFollower, PointsThatComeTogetherBecomeFewer) {
  const cv::Mat ground = Ground();
  TrackFollower follower;
  for (int i = 0; i < kKeyframes; ++i) {
    follower.AddFrame(SeenFrom(ground, 0.8 * std::pow(0.92, i)), true);
  }
  const FeatureTracks tracks = follower.Finish();
  ASSERT_EQ(tracks.num_images, static_cast<std::uint32_t>(kKeyframes));
  std::vector<std::vector<Eigen::Vector2f>> seen(kKeyframes);
  std::size_t num_sights = 0;
  for (const FeatureTrack& track : tracks.tracks) {
    num_sights += track.size();
    for (const TrackSight& sight : track) {
      seen[sight.image].push_back(sight.pixel_px);
    }
  }
  // A point takes up a 48th of the width, less some slack.
  for (const auto& points : seen) {
    EXPECT_GT(points.size(), 100U);
    for (std::size_t a = 0; a < points.size(); ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        EXPECT_GT((points[a] - points[b]).norm(), 0.6F * kWidth_px / 48.0F);
      }
    }
  }
  // They are still followed for a while.
  EXPECT_GT(num_sights, 4 * tracks.tracks.size());
}

}  // namespace
}  // namespace groundlock::build::internal
