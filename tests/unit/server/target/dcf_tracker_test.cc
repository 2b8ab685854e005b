// SPDX-License-Identifier: Apache-2.0
#include "server/target/dcf_tracker.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace groundlock::target {
namespace {

using geometry::Box2;

// Smooth random colours: a texture that can be moved by parts of a pixel.
cv::Mat Texture(int width, int height, std::uint64_t seed, double blur_px) {
  cv::Mat noise(height, width, CV_8UC3);
  cv::RNG rng(seed);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 256);
  cv::Mat smooth;
  cv::GaussianBlur(noise, smooth, {}, blur_px);
  cv::normalize(smooth, smooth, 0, 255, cv::NORM_MINMAX);
  return smooth;
}

// The background with the target's texture pasted such that the target's box
// has its corner at (x, y).
cv::Mat Scene(const cv::Mat& background,
              const cv::Mat& target,
              double x,
              double y) {
  cv::Mat image = background.clone();
  cv::warpAffine(target,
                 image,
                 cv::Matx23d(1, 0, x, 0, 1, y),
                 image.size(),
                 cv::INTER_CUBIC,
                 cv::BORDER_TRANSPARENT);
  return image;
}

class DcfTrackerTest : public ::testing::Test {
 protected:
  cv::Mat At(double x, double y) const {
    return Scene(background_, target_, x, y);
  }
  // The target covers 60 x 40 pixels; warpAffine's cubic border leaves out a
  // pixel at its rim, the same in all frames.
  static Box2 BoxAt(double x, double y) { return Box2::FromXywh(x, y, 60, 40); }
  TargetObservation Detect(const cv::Mat& image) {
    auto seen = tracker_.Detect(image, /*fixed_size=*/true);
    EXPECT_TRUE(seen.ok()) << seen.status();
    return *seen;
  }

  cv::Mat background_ = Texture(320, 240, 1, 6.0);
  cv::Mat target_ = Texture(60, 40, 2, 3.0);
  DcfTracker tracker_;
};

TEST_F(DcfTrackerTest, StaysOnASceneThatDoesNotMove) {
  const cv::Mat image = At(100, 80);
  ASSERT_TRUE(tracker_.Initialize(image, BoxAt(100, 80)).ok());
  const TargetObservation seen = Detect(image);
  // Locked on the very patch it was trained on. A cell is 5.1 px: a hundredth.
  EXPECT_NEAR(seen.box_px.x(), 100.0, 0.05);
  EXPECT_NEAR(seen.box_px.y(), 80.0, 0.05);
  EXPECT_GT(seen.confidence, 0.99);
}

// A whole image that moves is the case without any model error. A cell is 5.1
// px here; 0.3 px asks for a seventeenth of one.
TEST_F(DcfTrackerTest, FollowsATranslationToAFractionOfACell) {
  const cv::Mat large = Texture(400, 300, 3, 4.0);
  const auto moved = [&large](double x, double y) {
    cv::Mat image;
    cv::warpAffine(large,
                   image,
                   cv::Matx23d(1, 0, x, 0, 1, y),
                   large.size(),
                   cv::INTER_CUBIC,
                   cv::BORDER_REPLICATE);
    return image;
  };
  ASSERT_TRUE(
      tracker_.Initialize(moved(0, 0), Box2::FromXywh(150, 110, 60, 40)).ok());
  double x = 0.0;
  double y = 0.0;
  for (int frame = 0; frame < 20; ++frame) {
    x += 2.375;  // warpAffine knows 1/32 px
    y += frame < 10 ? 1.53125 : -1.25;
    const cv::Mat image = moved(x, y);
    const TargetObservation seen = Detect(image);
    EXPECT_NEAR(seen.box_px.x(), 150 + x, 0.3) << "frame " << frame;
    EXPECT_NEAR(seen.box_px.y(), 110 + y, 0.3) << "frame " << frame;
    EXPECT_NEAR(seen.box_px.width(), 60.0, 1e-9);
    EXPECT_GT(seen.confidence, 0.9) << "frame " << frame;
    tracker_.Learn(image);
  }
}

TEST_F(DcfTrackerTest, DoesNotLearnUnlessTold) {
  const cv::Mat first = At(100, 80);
  ASSERT_TRUE(tracker_.Initialize(first, BoxAt(100, 80)).ok());
  const TargetObservation before = Detect(first);
  const cv::Mat other = Scene(Texture(320, 240, 8, 6.0), target_, 104, 83);
  for (int i = 0; i < 10; ++i) Detect(other);
  tracker_.Place(BoxAt(100, 80));
  const TargetObservation after = Detect(first);
  EXPECT_EQ(before.box_px.min_px, after.box_px.min_px);
  EXPECT_EQ(before.confidence, after.confidence);
}

TEST_F(DcfTrackerTest, LearnsWhenTold) {
  ASSERT_TRUE(tracker_.Initialize(At(100, 80), BoxAt(100, 80)).ok());
  // The target slowly turns into another one.
  const cv::Mat other = Texture(60, 40, 5, 3.0);
  cv::Mat mixed = target_.clone();
  DcfTracker frozen;
  ASSERT_TRUE(frozen.Initialize(At(100, 80), BoxAt(100, 80)).ok());
  for (int i = 1; i <= 60; ++i) {
    cv::addWeighted(target_, 1 - i / 60.0, other, i / 60.0, 0, mixed);
    const cv::Mat image = Scene(background_, mixed, 100, 80);
    Detect(image);
    tracker_.Learn(image);
    ASSERT_TRUE(frozen.Detect(image, true).ok());
  }
  const cv::Mat last = Scene(background_, mixed, 100, 80);
  tracker_.Place(BoxAt(100, 80));
  frozen.Place(BoxAt(100, 80));
  const double learnt = Detect(last).confidence;
  EXPECT_GT(learnt, 0.9);
  EXPECT_LT(frozen.Detect(last, true)->confidence, learnt - 0.1);
}

TEST_F(DcfTrackerTest, PlaceMovesTheSearch) {
  ASSERT_TRUE(tracker_.Initialize(At(40, 40), BoxAt(40, 40)).ok());
  const cv::Mat image = At(200, 150);
  EXPECT_LT(Detect(image).confidence, 0.5) << "nothing there";
  tracker_.Place(BoxAt(206, 145));
  const TargetObservation seen = Detect(image);
  // The background around the target differs from where it was learnt.
  EXPECT_NEAR(seen.box_px.x(), 200.0, 1.0);
  EXPECT_NEAR(seen.box_px.y(), 150.0, 1.0);
  EXPECT_GT(seen.confidence, 0.5);
}

TEST_F(DcfTrackerTest, PlaceSetsTheSize) {
  ASSERT_TRUE(tracker_.Initialize(At(100, 80), BoxAt(100, 80)).ok());
  cv::Mat twice;
  cv::resize(At(100, 80), twice, {}, 2.0, 2.0, cv::INTER_CUBIC);
  tracker_.Place(Box2::FromXywh(204, 157, 120, 80));
  const TargetObservation seen = Detect(twice);
  EXPECT_NEAR(seen.box_px.x(), 200.0, 1.0);
  EXPECT_NEAR(seen.box_px.y(), 160.0, 1.0);
  EXPECT_EQ(seen.box_px.width(), 120.0);
  EXPECT_GT(seen.confidence, 0.9);
}

// What an occluder does: it slides over the target, stays, and goes.
TEST_F(DcfTrackerTest, ConfidenceDropsWhileHiddenAndRecovers) {
  const cv::Mat open = At(100, 80);
  ASSERT_TRUE(tracker_.Initialize(open, BoxAt(100, 80)).ok());
  const cv::Mat occluder = Texture(90, 90, 9, 2.0);
  const auto step = [this](const cv::Mat& image) {
    tracker_.Place(BoxAt(100, 80));  // the 3D model knows where it must be
    const TargetObservation seen = Detect(image);
    if (seen.confidence >= 0.5) tracker_.Learn(image);
    return seen.confidence;
  };
  for (int i = 0; i < 10; ++i) EXPECT_GT(step(open), 0.95);
  for (int x = 0; x <= 80; x += 4) step(Scene(open, occluder, x, 60));
  for (int i = 0; i < 30; ++i) {
    EXPECT_LT(step(Scene(open, occluder, 84, 60)), 0.5) << "hidden, " << i;
  }
  for (int x = 84; x <= 220; x += 4) step(Scene(open, occluder, x, 60));
  for (int i = 0; i < 10; ++i) EXPECT_GT(step(open), 0.9) << "back, " << i;
}

TEST_F(DcfTrackerTest, FollowsAZoomUnlessTheSizeIsFixed) {
  const cv::Mat start = At(130, 100);
  const Box2 box = BoxAt(130, 100);
  ASSERT_TRUE(tracker_.Initialize(start, box).ok());
  DcfTracker fixed;
  ASSERT_TRUE(fixed.Initialize(start, box).ok());
  double factor = 1.0;
  Box2 free_px = box;
  for (int i = 0; i < 40; ++i) {
    factor *= 1.01;
    cv::Mat zoomed;
    // About the target's centre, the index (159.5, 119.5).
    cv::warpAffine(
        start,
        zoomed,
        cv::Matx23d(
            factor, 0, 159.5 * (1 - factor), 0, factor, 119.5 * (1 - factor)),
        start.size(),
        cv::INTER_CUBIC,
        cv::BORDER_REPLICATE);
    const auto seen = tracker_.Detect(zoomed, /*fixed_size=*/false);
    ASSERT_TRUE(seen.ok());
    tracker_.Learn(zoomed);
    free_px = seen->box_px;
    const auto kept = fixed.Detect(zoomed, /*fixed_size=*/true);
    ASSERT_TRUE(kept.ok());
    ASSERT_NEAR(kept->box_px.width(), 60.0, 1e-9);
  }
  // 49 % larger; 5 % of it is an overlap of 0.9.
  EXPECT_NEAR(free_px.width() / 60.0, factor, 0.05 * factor);
  EXPECT_NEAR(free_px.height() / 40.0, factor, 0.05 * factor);
  EXPECT_LT((free_px.center_px() - box.center_px()).norm(), 2.0);
}

TEST_F(DcfTrackerTest, RefusesWhatItCannotStartOn) {
  EXPECT_FALSE(tracker_.Detect(background_, true).ok());
  EXPECT_FALSE(tracker_.Initialize(cv::Mat(), BoxAt(0, 0)).ok());
  EXPECT_FALSE(tracker_.Initialize(cv::Mat(9, 9, CV_32FC1), BoxAt(0, 0)).ok());
  EXPECT_FALSE(tracker_.Initialize(background_, BoxAt(320, 0)).ok());
  EXPECT_FALSE(tracker_.Initialize(background_, BoxAt(0, -40)).ok());
}

}  // namespace
}  // namespace groundlock::target
