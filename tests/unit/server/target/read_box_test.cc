// SPDX-License-Identifier: Apache-2.0
// What a tracker says that it reads is all that it reads: the rest of the image
// may be anything.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

#include "server/target/target_tracker.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

cv::Mat Texture() {
  cv::Mat coarse(45, 80, CV_8UC3);
  cv::RNG rng(5);
  rng.fill(coarse, cv::RNG::UNIFORM, 0, 256);
  cv::Mat image;
  cv::resize(coarse, image, {960, 540}, 0, 0, cv::INTER_CUBIC);
  return image;
}

// `image` within `read_px`, and garbage elsewhere.
cv::Mat OnlyWithin(const cv::Mat& image, const Box2& read_px, int seed) {
  cv::Mat out(image.size(), image.type());
  cv::RNG(static_cast<std::uint64_t>(seed)).fill(out, cv::RNG::UNIFORM, 0, 256);
  const auto clamp = [](double px, int size) {
    return static_cast<int>(std::clamp(px, 0.0, 1.0 * size));
  };
  const cv::Rect region(
      cv::Point(clamp(std::floor(read_px.min_px.x()), image.cols),
                clamp(std::floor(read_px.min_px.y()), image.rows)),
      cv::Point(clamp(std::ceil(read_px.max_px.x()), image.cols),
                clamp(std::ceil(read_px.max_px.y()), image.rows)));
  image(region).copyTo(out(region));
  return out;
}

class ReadBox : public testing::TestWithParam<std::string> {};

TEST_P(ReadBox, RestOfTheImageDoesNotMatter) {
  const cv::Mat texture = Texture();
  for (const Box2& start_px : {Box2::FromXywh(450, 250, 60, 40),
                               Box2::FromXywh(20, 30, 50, 90),
                               Box2::FromXywh(900, 480, 40, 40),
                               // So large that the image is halved for it.
                               Box2::FromXywh(300, 200, 200, 130)}) {
    auto seeing = *CreateTargetTracker({.name = GetParam()});
    auto blinkered = *CreateTargetTracker({.name = GetParam()});
    ASSERT_TRUE(seeing->Initialize(texture, start_px).ok());
    ASSERT_TRUE(blinkered->Initialize(texture, start_px).ok());
    Box2 box_px = start_px;
    for (int i = 0; i < 6; ++i) {
      cv::Mat image;
      cv::warpAffine(texture,
                     image,
                     cv::Matx23d(1, 0, 9.0 * i, 0, 1, -6.0 * i),
                     texture.size(),
                     cv::INTER_LINEAR,
                     cv::BORDER_REPLICATE);
      const bool fixed_size = i % 2 == 0;
      seeing->Place(box_px);
      blinkered->Place(box_px);
      const auto expected = seeing->Detect(image, fixed_size);
      const auto found = blinkered->Detect(
          OnlyWithin(image, blinkered->DetectBox(box_px), i), fixed_size);
      ASSERT_TRUE(expected.ok() && found.ok());
      EXPECT_EQ(found->box_px.min_px, expected->box_px.min_px);
      EXPECT_EQ(found->box_px.max_px, expected->box_px.max_px);
      EXPECT_EQ(found->confidence, expected->confidence);
      box_px = expected->box_px;
      if (fixed_size) {
        // As large as the target may be taken to look beside its box.
        const Box2 larger_px =
            Box2::FromCenter(box_px.center_px(), 1.5 * box_px.size_px());
        EXPECT_EQ(
            seeing->MeasureGrowth(image, larger_px),
            blinkered->MeasureGrowth(
                OnlyWithin(image, blinkered->DetectBox(box_px), i), larger_px));
      }
      seeing->Learn(image);
      blinkered->Learn(OnlyWithin(image, blinkered->LearnBox(box_px), i + 100));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Trackers,
                         ReadBox,
                         testing::Values("act", "dcf"),
                         [](const auto& test) { return test.param; });

TEST(ReadBox, IsEverythingByDefault) {
  const auto tracker = *CreateTargetTracker({.name = "kcf"});
  const Box2 box_px = Box2::FromXywh(1, 2, 3, 4);
  for (const Box2& read_px :
       {tracker->DetectBox(box_px), tracker->LearnBox(box_px)}) {
    EXPECT_LT(read_px.min_px.maxCoeff(), -1e9);
    EXPECT_GT(read_px.max_px.minCoeff(), 1e9);
  }
}

}  // namespace
}  // namespace groundlock::target
