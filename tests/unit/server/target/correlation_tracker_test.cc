// SPDX-License-Identifier: Apache-2.0
// What both of our own trackers do, each with its own precision.
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "server/target/act_tracker.h"
#include "server/target/dcf_tracker.h"
#include "tests/support/drawn_scene.h"
#include "tests/support/perturbation.h"

namespace groundlock::target {
namespace {

using geometry::Box2;
using test_support::Scene;
using test_support::Texture;

// Errors in pixels: on the very patch that was learnt, and while a whole image
// moves. A cell of act is 0.94 px here, one of dcf 5.1 px.
template <typename Tracker>
constexpr double kStillError_px = 0.05;
template <>
constexpr double kStillError_px<ActTracker> = 0.02;
template <typename Tracker>
constexpr double kMovingError_px = 0.3;
template <>
constexpr double kMovingError_px<ActTracker> = 0.1;

template <typename Tracker>
class CorrelationTracker : public ::testing::Test {
 protected:
  cv::Mat At(double x, double y) const {
    return Scene(background_, target_, x, y);
  }
  static Box2 BoxAt(double x, double y) { return Box2::FromXywh(x, y, 60, 40); }
  TargetObservation Detect(const cv::Mat& image) {
    auto seen = tracker_.Detect(image, /*fixed_size=*/true);
    EXPECT_TRUE(seen.ok()) << seen.status();
    return *seen;
  }

  cv::Mat background_ = Texture(320, 240, 1, 6.0);
  cv::Mat target_ = Texture(60, 40, 2, 3.0);
  Tracker tracker_;
};

using Trackers = ::testing::Types<ActTracker, DcfTracker>;
TYPED_TEST_SUITE(CorrelationTracker, Trackers);

TYPED_TEST(CorrelationTracker, StaysOnASceneThatDoesNotMove) {
  const cv::Mat image = this->At(100, 80);
  ASSERT_TRUE(this->tracker_.Initialize(image, this->BoxAt(100, 80)).ok());
  const TargetObservation seen = this->Detect(image);
  // Locked on the very patch it was trained on: the response is the desired
  // output up to the regularisation.
  EXPECT_NEAR(seen.box_px.x(), 100.0, kStillError_px<TypeParam>);
  EXPECT_NEAR(seen.box_px.y(), 80.0, kStillError_px<TypeParam>);
  EXPECT_GT(seen.confidence, 0.95);
}

// A whole image that moves is the case without any model error.
TYPED_TEST(CorrelationTracker, FollowsATranslationToAFractionOfACell) {
  const cv::Mat large = Texture(400, 300, 3, 4.0);
  ASSERT_TRUE(
      this->tracker_.Initialize(large, Box2::FromXywh(150, 110, 60, 40)).ok());
  // With a grey level of noise up to 0.105 px in 22 runs.
  const double bound_px =
      kMovingError_px<TypeParam> * test_support::Bound(1.0, 1.2);
  double x = 0.0;
  double y = 0.0;
  for (int frame = 0; frame < 20; ++frame) {
    x += 2.375;  // warpAffine knows 1/32 px
    y += frame < 10 ? 1.53125 : -1.25;
    const cv::Mat image = test_support::Moved(large, x, y);
    const TargetObservation seen = this->Detect(image);
    EXPECT_NEAR(seen.box_px.x(), 150 + x, bound_px) << "frame " << frame;
    EXPECT_NEAR(seen.box_px.y(), 110 + y, bound_px) << "frame " << frame;
    EXPECT_NEAR(seen.box_px.width(), 60.0, 1e-9);
    EXPECT_GT(seen.confidence, 0.9) << "frame " << frame;
    this->tracker_.Learn(image);
  }
}

TYPED_TEST(CorrelationTracker, DoesNotLearnUnlessTold) {
  const cv::Mat first = this->At(100, 80);
  ASSERT_TRUE(this->tracker_.Initialize(first, this->BoxAt(100, 80)).ok());
  const TargetObservation before = this->Detect(first);
  const cv::Mat other =
      Scene(Texture(320, 240, 8, 6.0), this->target_, 104, 83);
  for (int i = 0; i < 10; ++i) this->Detect(other);
  this->tracker_.Place(this->BoxAt(100, 80));
  const TargetObservation after = this->Detect(first);
  EXPECT_EQ(before.box_px.min_px, after.box_px.min_px);
  EXPECT_EQ(before.confidence, after.confidence);
}

TYPED_TEST(CorrelationTracker, LearnsWhenTold) {
  ASSERT_TRUE(
      this->tracker_.Initialize(this->At(100, 80), this->BoxAt(100, 80)).ok());
  // The target slowly turns into another one.
  const cv::Mat other = Texture(60, 40, 5, 3.0);
  cv::Mat mixed = this->target_.clone();
  TypeParam frozen;
  ASSERT_TRUE(frozen.Initialize(this->At(100, 80), this->BoxAt(100, 80)).ok());
  for (int i = 1; i <= 60; ++i) {
    cv::addWeighted(this->target_, 1 - i / 60.0, other, i / 60.0, 0, mixed);
    const cv::Mat image = Scene(this->background_, mixed, 100, 80);
    this->Detect(image);
    this->tracker_.Learn(image);
    ASSERT_TRUE(frozen.Detect(image, true).ok());
  }
  const cv::Mat last = Scene(this->background_, mixed, 100, 80);
  this->tracker_.Place(this->BoxAt(100, 80));
  frozen.Place(this->BoxAt(100, 80));
  const double learnt = this->Detect(last).confidence;
  EXPECT_GT(learnt, 0.9);
  EXPECT_LT(frozen.Detect(last, true)->confidence, learnt - 0.1);
}

TYPED_TEST(CorrelationTracker, PlaceMovesTheSearch) {
  ASSERT_TRUE(
      this->tracker_.Initialize(this->At(40, 40), this->BoxAt(40, 40)).ok());
  const cv::Mat image = this->At(200, 150);
  const double of_nothing = this->Detect(image).confidence;
  this->tracker_.Place(this->BoxAt(206, 145));
  const TargetObservation seen = this->Detect(image);
  // The background around the target differs from where it was learnt.
  EXPECT_NEAR(seen.box_px.x(), 200.0, 1.0);
  EXPECT_NEAR(seen.box_px.y(), 150.0, 1.0);
  EXPECT_GT(seen.confidence, 0.5);
  // How sure act is of this background is near 0.5 (0.48 to 0.495 with noise of
  // a grey level), of the target 0.998.
  EXPECT_LT(of_nothing, seen.confidence - 0.3);
}

TYPED_TEST(CorrelationTracker, PlaceSetsTheSize) {
  ASSERT_TRUE(
      this->tracker_.Initialize(this->At(100, 80), this->BoxAt(100, 80)).ok());
  cv::Mat twice;
  cv::resize(this->At(100, 80), twice, {}, 2.0, 2.0, cv::INTER_CUBIC);
  this->tracker_.Place(Box2::FromXywh(204, 157, 120, 80));
  const TargetObservation seen = this->Detect(twice);
  EXPECT_NEAR(seen.box_px.x(), 200.0, 1.0);
  EXPECT_NEAR(seen.box_px.y(), 160.0, 1.0);
  EXPECT_NEAR(seen.box_px.width(), 120.0, 1e-9);
  EXPECT_GT(seen.confidence, 0.9);
}

// What an occluder does: it slides over the target, stays, and goes.
TYPED_TEST(CorrelationTracker, ConfidenceDropsWhileHiddenAndRecovers) {
  const cv::Mat open = this->At(100, 80);
  ASSERT_TRUE(this->tracker_.Initialize(open, this->BoxAt(100, 80)).ok());
  const cv::Mat occluder = Texture(90, 90, 9, 2.0);
  const auto step = [this](const cv::Mat& image) {
    this->tracker_.Place(
        this->BoxAt(100, 80));  // the 3D model knows where it must be
    const TargetObservation seen = this->Detect(image);
    if (seen.confidence >= 0.5) this->tracker_.Learn(image);
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

TYPED_TEST(CorrelationTracker, RefusesWhatItCannotStartOn) {
  EXPECT_FALSE(this->tracker_.Detect(this->background_, true).ok());
  EXPECT_FALSE(this->tracker_.Initialize(cv::Mat(), this->BoxAt(0, 0)).ok());
  EXPECT_FALSE(
      this->tracker_.Initialize(cv::Mat(9, 9, CV_32FC1), this->BoxAt(0, 0))
          .ok());
  EXPECT_FALSE(
      this->tracker_.Initialize(this->background_, this->BoxAt(320, 0)).ok());
  EXPECT_FALSE(
      this->tracker_.Initialize(this->background_, this->BoxAt(0, -40)).ok());
}

}  // namespace
}  // namespace groundlock::target
