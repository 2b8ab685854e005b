// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/sift_features.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

namespace groundlock::features {
namespace {

TEST(RootSift, IsTheRootOfTheL1NormalisedVectorTimes512) {
  std::array<float, 128> sift{};
  sift[3] = 30.0F;
  sift[40] = 10.0F;
  const map::Descriptor root = RootSift(sift);
  EXPECT_EQ(root[3], 255);   // 512 sqrt(0.75) = 443, clipped
  EXPECT_EQ(root[40], 255);  // 512 sqrt(0.25) = 256, clipped
  EXPECT_EQ(root[0], 0);
  sift.fill(2.0F);
  // 512 sqrt(1 / 128) = 45.25
  EXPECT_EQ(RootSift(sift)[77], 45);
  sift.fill(0.0F);
  EXPECT_EQ(RootSift(sift), map::Descriptor{});
}

// Gaussian blobs at known places, in coordinates whose first pixel's centre is
// (0.5, 0.5).
cv::Mat DrawBlobs(const std::vector<Eigen::Vector2d>& centers_px,
                  double sigma_px) {
  cv::Mat image(400, 600, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      double value = 40.0;
      for (const Eigen::Vector2d& center : centers_px) {
        const double squared =
            (Eigen::Vector2d(x + 0.5, y + 0.5) - center).squaredNorm();
        value += 150.0 * std::exp(-0.5 * squared / (sigma_px * sigma_px));
      }
      image.at<uchar>(y, x) = cv::saturate_cast<uchar>(value);
    }
  }
  return image;
}

// Without the corrections the error would be 0.5 or 0.25 px.
TEST(ExtractSift, FindsBlobsWhereTheyAre) {
  const std::vector<Eigen::Vector2d> centers_px = {
      {80.5, 90.5}, {250.0, 300.2}, {470.8, 120.3}};
  for (const double sigma_px : {3.0, 5.0, 9.0}) {
    const auto features = ExtractSift(DrawBlobs(centers_px, sigma_px), {}, {});
    ASSERT_TRUE(features.ok()) << features.status();
    for (const Eigen::Vector2d& center : centers_px) {
      double nearest = std::numeric_limits<double>::infinity();
      for (const Eigen::Vector2d& keypoint : features->keypoints_px) {
        nearest = std::min(nearest, (keypoint - center).norm());
      }
      // The quadratic peak interpolation is good to some hundredths.
      EXPECT_LT(nearest, 0.06) << "sigma " << sigma_px;
    }
  }
}

TEST(ExtractSift, LeavesOutMasks) {
  const std::vector<Eigen::Vector2d> centers_px = {{100.0, 200.0},
                                                   {400.0, 200.0}};
  const cv::Mat image = DrawBlobs(centers_px, 5.0);
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<geometry::Box2> masks_px = {
      geometry::Box2::FromXywh(300.0, -1e12, 1e12, 2e12),
      geometry::Box2::FromXywh(90.0, 190.0, -5.0, -5.0),  // inverted: nothing
      geometry::Box2::FromXywh(kNan, 0.0, 10.0, 10.0)};
  const auto features = ExtractSift(image, masks_px, {});
  ASSERT_TRUE(features.ok()) << features.status();
  ASSERT_FALSE(features->keypoints_px.empty());
  for (const Eigen::Vector2d& keypoint : features->keypoints_px) {
    EXPECT_LT(keypoint.x(), 300.0);
  }
}

TEST(ExtractSift, KeepsNoMoreThanAsked) {
  std::mt19937 engine(1);
  cv::Mat noise(200, 200, CV_8UC1);
  for (int y = 0; y < noise.rows; ++y) {
    for (int x = 0; x < noise.cols; ++x) {
      noise.at<uchar>(y, x) = static_cast<uchar>(engine());
    }
  }
  const auto features = ExtractSift(noise, {}, {.max_features = 50});
  ASSERT_TRUE(features.ok());
  EXPECT_EQ(features->descriptors.size(), features->keypoints_px.size());
  EXPECT_GE(features->descriptors.size(), 40U);
  // OpenCV keeps ties of the last response and several orientations.
  EXPECT_LE(features->descriptors.size(), 100U);
}

TEST(ExtractSift, ChecksTheImage) {
  EXPECT_FALSE(ExtractSift(cv::Mat(), {}, {}).ok());
  EXPECT_FALSE(ExtractSift(cv::Mat(8, 8, CV_8UC3, cv::Scalar()), {}, {}).ok());
  const auto flat =
      ExtractSift(cv::Mat(64, 64, CV_8UC1, cv::Scalar(90)), {}, {});
  ASSERT_TRUE(flat.ok()) << flat.status();
  EXPECT_TRUE(flat->keypoints_px.empty());
}

}  // namespace
}  // namespace groundlock::features
