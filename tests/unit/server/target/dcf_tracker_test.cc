// SPDX-License-Identifier: Apache-2.0
// What dcf does beyond correlation_tracker_test.cc.
#include "server/target/dcf_tracker.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/support/allocation_counter.h"
#include "tests/support/drawn_scene.h"
#include "tests/support/perturbation.h"

namespace groundlock::target {
namespace {

using geometry::Box2;
using test_support::Scene;
using test_support::Texture;

class DcfTrackerTest : public ::testing::Test {
 protected:
  cv::Mat At(double x, double y) const {
    return Scene(background_, target_, x, y);
  }
  static Box2 BoxAt(double x, double y) { return Box2::FromXywh(x, y, 60, 40); }
  static geometry::ConvexPolygon AsPolygon(const Box2& box) {
    return {{box.min_px,
             {box.max_px.x(), box.min_px.y()},
             box.max_px,
             {box.min_px.x(), box.max_px.y()}}};
  }

  cv::Mat background_ = Texture(320, 240, 1, 6.0);
  cv::Mat target_ = Texture(60, 40, 2, 3.0);
  DcfTracker tracker_;
};

TEST_F(DcfTrackerTest, FollowsAZoomOrTellsItWhereTheSizeIsFixed) {
  const cv::Mat start = At(130, 100);
  const Box2 box = BoxAt(130, 100);
  ASSERT_TRUE(tracker_.Initialize(start, box).ok());
  DcfTracker fixed;
  ASSERT_TRUE(fixed.Initialize(start, box).ok());
  double factor = 1.0;
  Box2 free_px = box;
  Eigen::Vector2d measured_px = box.size_px();
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
    const auto growth = fixed.MeasureGrowth(
        zoomed, Box2::FromCenter(kept->box_px.center_px(), measured_px));
    ASSERT_TRUE(growth.has_value());
    measured_px *= *growth;
    fixed.Learn(zoomed);
  }
  std::printf("%.3f times as large: measured %.3f, seen %.3f by %.3f\n",
              factor,
              measured_px.x() / 60.0,
              free_px.width() / 60.0,
              free_px.height() / 40.0);
  EXPECT_NEAR(measured_px.x() / 60.0, factor, 0.05 * factor);
  // 49 % larger. Noise of a grey level makes either side 7 % too short, the
  // other too long.
  EXPECT_NEAR(std::sqrt(free_px.Area() / box.Area()), factor, 0.05 * factor);
  const double side = test_support::Bound(0.05, 0.12);
  EXPECT_NEAR(free_px.width() / 60.0, factor, side * factor);
  EXPECT_NEAR(free_px.height() / 40.0, factor, side * factor);
  EXPECT_LT((free_px.center_px() - box.center_px()).norm(),
            test_support::Bound(2.0, 4.0));
}

// Two of the same pass each other. Where they part, both look right; only the
// way they went tells which is which.
TEST_F(DcfTrackerTest, OfTwoTheSameTheExpectedOneIsTaken) {
  const auto two = [this](double x, double other_x) {
    return Scene(At(x, 100), target_, other_x, 100);
  };
  const cv::Mat first = two(40, 200);
  ASSERT_TRUE(tracker_.Initialize(first, BoxAt(40, 100)).ok());
  const Eigen::Matrix2d sure = 25.0 * Eigen::Matrix2d::Identity();
  // Between them, nearer to the other one.
  const cv::Mat parted = two(160, 80);
  tracker_.Place(BoxAt(116, 100));
  tracker_.Expect(BoxAt(152, 100).center_px(), sure);
  auto seen = tracker_.Detect(parted, /*fixed_size=*/true);
  ASSERT_TRUE(seen.ok());
  EXPECT_NEAR(seen->box_px.x(), 160.0, 2.0);
  tracker_.Place(BoxAt(124, 100));
  tracker_.Expect(BoxAt(86, 100).center_px(), sure);
  seen = tracker_.Detect(parted, /*fixed_size=*/true);
  ASSERT_TRUE(seen.ok());
  EXPECT_NEAR(seen->box_px.x(), 80.0, 2.0);
  // An expectation is for one look, and one without numbers says nothing.
  tracker_.Place(BoxAt(160, 100));
  tracker_.Expect({std::nan(""), 0.0}, sure);
  seen = tracker_.Detect(parted, /*fixed_size=*/true);
  ASSERT_TRUE(seen.ok());
  EXPECT_NEAR(seen->box_px.x(), 160.0, 2.0);
}

// Its like stands before a part of the target: where that is known, what is
// seen of the target is what is found.
TEST_F(DcfTrackerTest, WhatIsLeftOutIsNotTheTarget) {
  ASSERT_TRUE(tracker_.Initialize(At(120, 100), BoxAt(120, 100)).ok());
  const cv::Mat both = Scene(At(120, 100), target_, 145, 115);
  const auto look = [&] {
    tracker_.Place(BoxAt(128, 104));
    return *tracker_.Detect(both, /*fixed_size=*/true);
  };
  const TargetObservation without = look();
  EXPECT_NEAR(without.box_px.x(), 145.0, 2.0);
  tracker_.LeaveOut(std::array{AsPolygon(BoxAt(145, 115))});
  const TargetObservation with = look();
  EXPECT_NEAR(with.box_px.x(), 120.0, 2.0);
  EXPECT_NEAR(with.box_px.y(), 100.0, 2.0);
  EXPECT_GT(with.confidence, 0.5);
  // That was for one look.
  EXPECT_EQ(look().box_px.x(), without.box_px.x());
  // Nothing is found where nothing is left to look at.
  tracker_.LeaveOut(std::array{AsPolygon(Box2::FromXywh(0, 0, 320, 240))});
  const TargetObservation nothing = look();
  EXPECT_EQ(nothing.confidence, 0.0);
  EXPECT_EQ(nothing.box_px.x(), 128.0);
  EXPECT_EQ(nothing.box_px.y(), 104.0);
}

// An expectation must not make a target of what does not look like one.
TEST_F(DcfTrackerTest, AWrongExpectationDoesNotMoveTheTarget) {
  const cv::Mat image = At(130, 100);
  ASSERT_TRUE(tracker_.Initialize(image, BoxAt(130, 100)).ok());
  tracker_.Expect(BoxAt(70, 60).center_px(),
                  25.0 * Eigen::Matrix2d::Identity());
  const auto seen = tracker_.Detect(image, /*fixed_size=*/true);
  ASSERT_TRUE(seen.ok());
  EXPECT_NEAR(seen->box_px.x(), 130.0, 0.1);
  EXPECT_NEAR(seen->box_px.y(), 100.0, 0.1);
}

// A wall that slides over the target, slowly, must not become the target.
TEST_F(DcfTrackerTest, DoesNotLearnWhatSlidesOverTheTarget) {
  const cv::Mat wall(200, 200, CV_8UC3, cv::Scalar(60, 140, 60));
  const cv::Mat red = Texture(60, 40, 4, 3.0).mul(cv::Scalar(0.2, 0.2, 1.0));
  cv::Mat target = red.clone();
  cv::add(target, cv::Scalar(0, 0, 60), target);
  const cv::Mat open = Scene(background_, target, 100, 100);
  ASSERT_TRUE(tracker_.Initialize(open, BoxAt(100, 100)).ok());
  double confidence = 0.0;
  for (int i = 0; i < 60; ++i) {
    const cv::Mat image =
        Scene(open, wall, 170.0 - std::max(0, i - 10) * 2.5, 20);
    const auto seen = tracker_.Detect(image, /*fixed_size=*/true);
    ASSERT_TRUE(seen.ok());
    confidence = seen->confidence;
    if (confidence >= 0.5) tracker_.Learn(image);
  }
  EXPECT_LT(confidence, 0.5) << "all of it is hidden";
  tracker_.Place(BoxAt(102, 98));
  const auto back = tracker_.Detect(open, /*fixed_size=*/true);
  ASSERT_TRUE(back.ok());
  EXPECT_GT(back->confidence, 0.65);
  EXPECT_NEAR(back->box_px.x(), 100.0, 1.5);
}

// What a search goes by: the target, also a changed one, is told from all other
// places of the image.
TEST_F(DcfTrackerTest, RecognisesTheTargetAmongOtherPlaces) {
  ASSERT_TRUE(tracker_.Initialize(At(130, 100), BoxAt(130, 100)).ok());
  cv::Mat changed = At(30, 60);
  cv::GaussianBlur(changed, changed, {}, 1.5);
  const auto look = [&](double x, double y) {
    tracker_.Place(BoxAt(x, y));
    const auto seen = tracker_.Detect(changed, /*fixed_size=*/true);
    EXPECT_TRUE(seen.ok());
    EXPECT_TRUE(seen->recognition.has_value());
    return seen->recognition.value_or(0.0);
  };
  const double there = look(32, 59);
  EXPECT_GT(there, 0.8);
  for (const double x : {160.0, 200.0, 240.0}) {
    for (const double y : {20.0, 100.0, 180.0}) {
      EXPECT_LT(look(x, y), 0.8) << x << ", " << y;
    }
  }
}

// It turns into something else, is learnt so, and turns back.
TEST_F(DcfTrackerTest, RecallsWhatTheTargetLookedLike) {
  const cv::Mat image = At(130, 100);
  const cv::Mat other = Scene(background_, Texture(60, 40, 9, 3.0), 130, 100);
  ASSERT_TRUE(tracker_.Initialize(image, BoxAt(130, 100)).ok());
  std::unique_ptr<Appearance> kept;
  tracker_.Keep(kept);
  ASSERT_NE(kept, nullptr);
  DcfTracker changed;
  ASSERT_TRUE(changed.Initialize(other, BoxAt(130, 100)).ok());
  std::unique_ptr<Appearance> another;
  changed.Keep(another);
  const auto look = [&](double* confidence) {
    changed.Place(BoxAt(134, 98));
    const auto seen = changed.Detect(image, /*fixed_size=*/true);
    *confidence = seen.ok() ? seen->confidence : -1.0;
    return seen.ok() ? seen->box_px.center_px() : Eigen::Vector2d(0.0, 0.0);
  };
  double without = 0.0;
  look(&without);
  EXPECT_LT(without, 0.3);
  const std::vector<const Appearance*> both = {another.get(), kept.get()};
  changed.Recall(both);
  double recalled = 0.0;
  const Eigen::Vector2d found = look(&recalled);
  EXPECT_GT(recalled, 0.8);
  EXPECT_LT((found - BoxAt(130, 100).center_px()).norm(), 1.5);
  // For one look, unless it is adopted.
  double again = 0.0;
  look(&again);
  EXPECT_LT(again, 0.3);
  changed.Recall(both);
  look(&again);
  changed.Adopt();
  look(&again);
  EXPECT_GT(again, 0.8);
  // What there is wins where it is surer.
  changed.Recall({&both[0], 1});
  look(&again);
  EXPECT_GT(again, 0.8);
}

TEST_F(DcfTrackerTest, AsksForNoMemoryAfterTheFirstFrames) {
  if (!test_support::AllocationsAreCounted()) {
    GTEST_SKIP() << "the sanitizer has an allocator of its own";
  }
  std::vector<cv::Mat> frames;
  for (int i = 0; i < 12; ++i) frames.push_back(At(100 + 2 * i, 90 + i));
  ASSERT_TRUE(tracker_.Initialize(frames[0], BoxAt(100, 90)).ok());
  std::uint64_t before = 0;
  for (std::size_t i = 1; i < frames.size(); ++i) {
    if (i == 4) before = test_support::AllocationCount();
    ASSERT_TRUE(tracker_.Detect(frames[i], /*fixed_size=*/false).ok());
    tracker_.Learn(frames[i]);
  }
  EXPECT_EQ(test_support::AllocationCount() - before, 0U);
}

}  // namespace
}  // namespace groundlock::target
