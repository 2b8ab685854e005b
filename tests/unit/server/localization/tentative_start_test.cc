// SPDX-License-Identifier: Apache-2.0
// Frames of which so little agrees with the map that one alone is not believed.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "server/localization/search/anchoring.h"
#include "server/localization/solvers/agreement.h"
#include "tests/unit/server/localization/same_result.h"
#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

class TentativeStartTest : public WalkTest {
 protected:
  // All but a window in the middle is masked.
  static std::vector<geometry::Box2> AroundWindow() {
    constexpr double kLeft_px = 250.0;
    constexpr double kTop_px = 125.0;
    constexpr double kWidth_px = 140.0;
    constexpr double kHeight_px = 100.0;
    const double right_px = kLeft_px + kWidth_px;
    const double bottom_px = kTop_px + kHeight_px;
    return {
        geometry::Box2::FromXywh(-1.0, -1.0, kLeft_px + 1.0, 400.0),
        geometry::Box2::FromXywh(right_px, -1.0, 641.0 - right_px, 400.0),
        geometry::Box2::FromXywh(-1.0, -1.0, 700.0, kTop_px + 1.0),
        geometry::Box2::FromXywh(-1.0, bottom_px, 700.0, 361.0 - bottom_px)};
  }
  static LocalizationResult Localize(Localizer& localizer,
                                     const cv::Mat& luma,
                                     int frame) {
    return WalkTest::Localize(localizer, luma, frame, AroundWindow());
  }
  // In a window of 140 px the camera's place along the axis is hardly seen. A
  // small plane is seen alike from either side of its normal, and noise decides
  // which (docs/benchmarks.md, Beyond the map's end).
  static double Window_m() { return test_support::Bound(0.15, 3.0); }
  static double Error(const LocalizationResult& result, int frame) {
    return test_support::CenterError(*result.world_from_camera, TruthAt(frame));
  }
  static double LogFalseAlarmsOf(const cv::Mat& luma) {
    AnchorRequest request;
    request.luma = luma;
    request.camera = place_->camera();
    request.masks_px = AroundWindow();
    request.seed = test_support::PerturbedSeed(5);
    const auto anchor = FindAnchor(*map_, request, AnchorOptions());
    return anchor ? anchor->log_false_alarms : 0.0;
  }
};

TEST_F(TentativeStartTest, IsToldOnceAnotherFrameFindsTheSame) {
  const double log_false_alarms = LogFalseAlarmsOf(ImageAt(0));
  ASSERT_TRUE(IsBelieved(log_false_alarms)) << log_false_alarms;
  ASSERT_FALSE(IsSure(log_false_alarms)) << log_false_alarms;
  const auto localizer = Create();
  int frame = 0;
  LocalizationResult result;
  do {
    EXPECT_FALSE(result.world_from_camera) << frame;
    EXPECT_EQ(result.state, CameraState::kInitializing) << frame;
    EXPECT_EQ(result.reset_count, 0U);
    result = Localize(*localizer, ImageAt(frame), frame);
  } while (result.state != CameraState::kTracked && ++frame < 40);
  EXPECT_GE(frame, 8);
  EXPECT_LE(frame, 24);
  for (const int end = frame + 6; frame < end; ++frame) {
    result = Localize(*localizer, ImageAt(frame), frame);
    ASSERT_EQ(result.state, CameraState::kTracked) << frame;
    EXPECT_EQ(result.reset_count, 1U);
    EXPECT_LT(Error(result, frame), Window_m());
  }
}

TEST_F(TentativeStartTest, APhotographIsGivenAsItIs) {
  LocalizerOptions options = LocalizerOptionsOfWalk();
  options.is_single_frame = true;
  const auto localizer = CreateLocalizer("fast", map_, options);
  ASSERT_TRUE(localizer.ok()) << localizer.status();
  const LocalizationResult result = Localize(**localizer, ImageAt(0), 0);
  ASSERT_EQ(result.state, CameraState::kTracked);
  EXPECT_LT(Error(result, 0), Window_m());
}

TEST_F(TentativeStartTest, GoesOnInAnotherSession) {
  const auto localizer = Create();
  for (int frame = 0; frame < 6; ++frame) {
    Localize(*localizer, ImageAt(frame), frame);
  }
  const auto moved = Create();
  const absl::Status restored = moved->Restore(localizer->Save());
  ASSERT_TRUE(restored.ok()) << restored;
  bool was_told = false;
  for (int frame = 6; frame < 30; ++frame) {
    const auto here = Localize(*localizer, ImageAt(frame), frame);
    ExpectSame(here, Localize(*moved, ImageAt(frame), frame), frame);
    was_told = was_told || here.state == CameraState::kTracked;
  }
  EXPECT_TRUE(was_told);
}

// A live session whose anchors come when the test wants them to, so that it can
// exchange their images meanwhile.
class ContradictedStartTest : public TentativeStartTest {
 protected:
  void RunWaitingTasks() {
    while (!tasks_.empty()) {
      tasks_.front()();
      tasks_.pop_front();
    }
  }
  // Follows the walk from `frame_` until an anchor is asked for, which then
  // sees the camera `aside_m` to the right of where it is.
  void AskForAnchor(double aside_m) {
    cv::Mat shared;
    for (int tries = 0; tasks_.empty(); ++tries) {
      ASSERT_LT(tries, 60);
      shared = ImageAt(frame_).clone();
      last_ = Localize(*localizer_, shared, frame_++);
    }
    geometry::Rigid3 elsewhere = TruthAt(frame_ - 1);
    elsewhere.translation.x() += aside_m;
    place_->Render(elsewhere).copyTo(shared);
    RunWaitingTasks();
    last_ = Localize(*localizer_, ImageAt(frame_), frame_);
    ++frame_;
  }

  int frame_ = 0;
  LocalizationResult last_;
  std::deque<std::function<void()>> tasks_;
  std::unique_ptr<Localizer> localizer_ =
      Create(/*wait_for_anchor=*/false,
             [this](Urgency, std::function<void()> task) {
               tasks_.push_back(std::move(task));
             },
             /*lost_after=*/std::chrono::seconds(2));
};

TEST_F(ContradictedStartTest, WhatNoOtherFrameFindsIsNeverTold) {
  AskForAnchor(0.0);
  EXPECT_EQ(last_.state, CameraState::kInitializing);
  AskForAnchor(0.3);
  EXPECT_EQ(last_.state, CameraState::kInitializing);
  AskForAnchor(0.0);
  EXPECT_EQ(last_.state, CameraState::kInitializing);
  AskForAnchor(0.0);
  ASSERT_EQ(last_.state, CameraState::kTracked);
  EXPECT_EQ(last_.reset_count, 1U);
  EXPECT_LT(Error(last_, frame_ - 1), Window_m());
}

TEST_F(ContradictedStartTest, FewAnchorsDoNotMoveACameraThatIsKnown) {
  for (int i = 0; i < 2; ++i) AskForAnchor(0.0);
  ASSERT_EQ(last_.state, CameraState::kTracked);
  // Too far away to be found where it is expected.
  constexpr double kAside_m = -1.6;
  for (int i = 0; i < 3; ++i) {
    AskForAnchor(kAside_m);
    ASSERT_EQ(last_.state, CameraState::kTracked) << i;
    EXPECT_EQ(last_.reset_count, 1U);
    EXPECT_LT(Error(last_, frame_ - 1), Window_m());
  }
  // Then nobody knows.
  AskForAnchor(kAside_m);
  EXPECT_EQ(last_.state, CameraState::kHeld);
  AskForAnchor(0.0);
  EXPECT_EQ(last_.state, CameraState::kHeld);
  // Another tells, unless it sees too little itself.
  for (int i = 0; i < 3 && last_.state != CameraState::kTracked; ++i) {
    AskForAnchor(0.0);
  }
  ASSERT_EQ(last_.state, CameraState::kTracked);
  EXPECT_GT(last_.reset_count, 1U);
  EXPECT_LT(Error(last_, frame_ - 1), Window_m());
}

}  // namespace
}  // namespace groundlock::localization
