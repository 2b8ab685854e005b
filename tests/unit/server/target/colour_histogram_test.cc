// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/colour_histogram.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace groundlock::target::internal {
namespace {

constexpr int kSide = 96;
const Eigen::Vector2d kTarget(24.0, 16.0);

// A red box, moved from the middle of a blue patch.
PatchSampler Patch(int x, int y, const cv::Scalar& colour) {
  cv::Mat image(kSide, kSide, CV_8UC3, cv::Scalar(200, 20, 20));
  cv::rectangle(image, {36 + x, 40 + y, 24, 16}, colour, cv::FILLED);
  PatchSampler sampler(kSide);
  sampler.Sample(image, geometry::Box2::FromXywh(0, 0, kSide, kSide));
  return sampler;
}

const cv::Scalar kRed(20, 20, 220);

TEST(ColourHistogram, IsHighestWhereTheColoursAre) {
  ColourHistogram colours(kSide);
  colours.Learn(Patch(0, 0, kRed), kTarget, 1.0);
  EXPECT_GT(colours.expected(), 0.9);
  EXPECT_LT(colours.around(), 0.1);
  colours.Look(Patch(20, -12, kRed));
  EXPECT_NEAR(
      colours.Likelihood({20.0, -12.0}, kTarget), colours.expected(), 0.05);
  EXPECT_LT(colours.Likelihood({0.0, 0.0}, kTarget), 0.4);
  EXPECT_LT(colours.Likelihood({-30.0, 30.0}, kTarget), 0.1);
  // Outside the patch there is nothing to be read.
  EXPECT_EQ(colours.Likelihood({1e6, 0.0}, kTarget), 0.0);
}

TEST(ColourHistogram, TellsOfEachPixelOfAnImage) {
  ColourHistogram colours(kSide);
  colours.Learn(Patch(0, 0, kRed), kTarget, 1.0);
  // Red, blue and a colour that was never seen.
  cv::Mat image(1, 3, CV_8UC3);
  image.at<cv::Vec3b>(0, 0) = {20, 20, 220};
  image.at<cv::Vec3b>(0, 1) = {200, 20, 20};
  image.at<cv::Vec3b>(0, 2) = {20, 220, 20};
  const cv::Mat probability = colours.Probability(image);
  ASSERT_EQ(probability.size(), image.size());
  EXPECT_GT(probability.at<float>(0, 0), 0.95F);
  EXPECT_LT(probability.at<float>(0, 1), 0.05F);
  EXPECT_FLOAT_EQ(probability.at<float>(0, 2), 0.5F);
}

TEST(ColourHistogram, FollowsAChangeAsFastAsItIsTold) {
  ColourHistogram slow(kSide);
  ColourHistogram fast(kSide);
  const cv::Scalar green(20, 220, 20);
  for (ColourHistogram* colours : {&slow, &fast}) {
    colours->Learn(Patch(0, 0, kRed), kTarget, 1.0);
    colours->Learn(Patch(0, 0, green), kTarget, colours == &slow ? 0.001 : 1.0);
    colours->Look(Patch(0, 0, kRed));
  }
  EXPECT_GT(slow.Likelihood({0.0, 0.0}, kTarget), 0.9);
  // Neither the target's nor its surroundings': nothing is known.
  EXPECT_NEAR(fast.Likelihood({0.0, 0.0}, kTarget), 0.5, 0.05);
}

TEST(ColourHistogram, EvidenceIsGreatestOfTheBoxThatHasTheColours) {
  ColourHistogram colours(kSide);
  colours.Learn(Patch(0, 0, kRed), kTarget, 1.0);
  colours.LookForBoxes(Patch(8, -4, kRed));
  const auto box = geometry::Box2::FromXywh(44, 36, 24, 16);
  const double whole = colours.BoxEvidence(box);
  // Every second sample of every second row, none surer than e^2 to 1.
  EXPECT_NEAR(whole, 2.0 * 12 * 8, 2.0 * 2 * (12 + 8));
  const Eigen::Vector2d step(2.0, 2.0);
  EXPECT_LT(colours.BoxEvidence({box.min_px - step, box.max_px}), whole);
  EXPECT_LT(colours.BoxEvidence({box.min_px + step, box.max_px}), whole);
  EXPECT_LT(colours.BoxEvidence({box.min_px, box.max_px + step}), whole);
  EXPECT_LT(colours.BoxEvidence({box.min_px, box.max_px - step}), whole);
  // What lies outside the patch says nothing.
  EXPECT_NEAR(colours.BoxEvidence(geometry::Box2::FromXywh(-50, -50, 40, 40)),
              0.0,
              1e-9);
}

TEST(ColourHistogram, SameColoursAllOverSayNothing) {
  ColourHistogram colours(kSide);
  colours.Learn(Patch(0, 0, cv::Scalar(200, 20, 20)), kTarget, 1.0);
  EXPECT_NEAR(colours.expected() - colours.around(), 0.0, 1e-3);
}

}  // namespace
}  // namespace groundlock::target::internal
