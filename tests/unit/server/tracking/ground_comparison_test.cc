// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/ground_comparison.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <random>

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr int kSide_px = 64;
// What is drawn in the middle.
const cv::Rect kMiddle(20, 20, 24, 24);
const Box2 kMiddle_px = Box2::FromXywh(20.0, 20.0, 24.0, 24.0);
const Box2 kNothing_px = Box2::FromXywh(-10.0, -10.0, 1.0, 1.0);

// Straight from above, of ground that is always the same, but for the middle.
class GroundComparisonTest : public testing::Test {
 protected:
  GroundPicture Picture() const {
    GroundPicture picture;
    picture.bgr.create(kSide_px, kSide_px, CV_8UC3);
    std::mt19937_64 random(3);
    for (int y = 0; y < kSide_px; ++y) {
      for (int x = 0; x < kSide_px; ++x) {
        picture.bgr.at<cv::Vec3b>(y, x) =
            cv::Vec3b::all(static_cast<std::uint8_t>(100 + random() % 40));
      }
    }
    picture.camera = camera_;
    picture.world_from_camera = {
        Eigen::Quaterniond(Eigen::Vector4d(1.0, 0.0, 0.0, 0.0)),
        {0.0, 0.0, 10.0}};
    return picture;
  }
  // Two colours at random in the middle.
  GroundPicture Painted(std::uint64_t seed) const {
    GroundPicture picture = Picture();
    std::mt19937_64 random(seed);
    for (int y = kMiddle.y; y < kMiddle.br().y; ++y) {
      for (int x = kMiddle.x; x < kMiddle.br().x; ++x) {
        picture.bgr.at<cv::Vec3b>(y, x) =
            random() % 2 == 0 ? cv::Vec3b(40, 40, 200) : cv::Vec3b(200, 40, 40);
      }
    }
    return picture;
  }
  // Of what was painted with the first seed, against those from another on.
  GroundLabels LabelsAgainst(std::uint64_t from_seed) const {
    const GroundPicture now = Painted(1);
    GroundComparison comparison(now, geometry::Plane{}, nullptr, kMiddle_px);
    for (std::uint64_t seed = from_seed; seed < 8; ++seed) {
      comparison.Add(Painted(seed), kNothing_px, kNothing_px);
    }
    return comparison.Label();
  }
  static double ShareInMiddle(const GroundLabels& labels, GroundLabel label) {
    return cv::countNonZero(labels(kMiddle) == label) /
           static_cast<double>(kMiddle.area());
  }

  const geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     kSide_px,
                                     kSide_px,
                                     std::array{100.0, 32.0, 32.0});
};

// Each of its pixels is in one earlier picture or another as it is now.
TEST_F(GroundComparisonTest, NoPictureShowsWhatIsMixedOfAll) {
  // In half of them it is as in the likest one.
  EXPECT_GT(ShareInMiddle(LabelsAgainst(2), kBody), 0.3);
}

TEST_F(GroundComparisonTest, WhatOnePictureShowsIsTheGround) {
  EXPECT_EQ(ShareInMiddle(LabelsAgainst(1), kBody), 0.0);
}

TEST_F(GroundComparisonTest, BrighterThanInTheShadeMayBeTheGround) {
  GroundPicture now = Picture();
  now.bgr(kMiddle).setTo(cv::Scalar::all(150));
  GroundPicture before = Picture();
  before.bgr(kMiddle).setTo(cv::Scalar::all(80));
  const auto labels = [&](const Box2& shaded_px) {
    GroundComparison comparison(now, geometry::Plane{}, nullptr, kMiddle_px);
    for (int i = 0; i < 2; ++i) comparison.Add(before, kNothing_px, shaded_px);
    return comparison.Label();
  };
  EXPECT_GT(ShareInMiddle(labels(kNothing_px), kBody), 0.9);
  EXPECT_GT(ShareInMiddle(labels(kMiddle_px), kEither), 0.9);
}

}  // namespace
}  // namespace groundlock::tracking
