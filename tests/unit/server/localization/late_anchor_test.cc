// SPDX-License-Identifier: Apache-2.0
// Anchors that arrive many frames after the one they were asked in, as on a
// machine that is busy: the camera is found and stays so.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <functional>
#include <memory>
#include <utility>

#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

class LateAnchorTest : public WalkTest {
 protected:
  LocalizationResult Localize(int frame) {
    return Localize(frame, ImageAt(frame));
  }
  LocalizationResult Localize(int frame, const cv::Mat& luma) {
    return WalkTest::Localize(*localizer_, luma, frame);
  }
  void RunWaitingTasks() {
    while (!tasks_.empty()) {
      tasks_.front()();
      tasks_.pop_front();
    }
  }

  const cv::Mat wall_{ImageAt(0).size(), CV_8UC1, cv::Scalar(128)};
  std::deque<std::function<void()>> tasks_;
  std::unique_ptr<Localizer> localizer_ =
      Create(/*wait_for_anchor=*/false,
             [this](Urgency, std::function<void()> task) {
               tasks_.push_back(std::move(task));
             },
             /*lost_after=*/std::chrono::seconds(2));
};

TEST_F(LateAnchorTest, FirstPoseIsFoundOverTheFramesBetween) {
  constexpr int kLate = 26;
  for (int frame = 0; frame < kLate; ++frame) {
    EXPECT_EQ(Localize(frame).state, CameraState::kInitializing);
    EXPECT_LE(tasks_.size(), 1U);
  }
  RunWaitingTasks();
  for (int frame = kLate; frame < kLate + 6; ++frame) {
    ExpectNear(Localize(frame), frame);
  }
}

TEST_F(LateAnchorTest, TrackedCameraStaysTracked) {
  Localize(0);
  RunWaitingTasks();
  for (int frame = 1; frame < 72; ++frame) {
    ExpectNear(Localize(frame), frame);
    // The anchor of every 24 frames arrives with the last of them.
    if (frame % 24 == 0) RunWaitingTasks();
  }
}

TEST_F(LateAnchorTest, CameraThatWasSoughtInVainIsStillFound) {
  constexpr int kLate = 12;
  constexpr int kInVain = 6;
  int frame = 0;
  for (int search = 0; search < kInVain; ++search) {
    for (int i = 0; i < kLate; ++i) {
      EXPECT_EQ(Localize(frame++, wall_).state, CameraState::kInitializing);
      EXPECT_LE(tasks_.size(), 1U);
    }
    RunWaitingTasks();
  }
  for (int i = 0; i < kLate; ++i) {
    Localize(frame++);
    EXPECT_LE(tasks_.size(), 1U);
  }
  RunWaitingTasks();
  ExpectNear(Localize(frame), frame);
}

TEST_F(LateAnchorTest, WhatWasFoundButNotFollowedIsHeld) {
  Localize(0);
  RunWaitingTasks();
  // Nothing to follow the landmarks in.
  const LocalizationResult held = Localize(10, wall_);
  ASSERT_EQ(held.state, CameraState::kHeld);
  EXPECT_EQ(held.reset_count, 1U);
  const double error =
      test_support::CenterError(*held.world_from_camera, TruthAt(0));
  EXPECT_LT(error, 0.03);
  // As far as a camera may have come meanwhile.
  EXPECT_GT(std::sqrt(held.covariance(0, 0)), 0.1);
  EXPECT_EQ(Localize(80, wall_).state, CameraState::kLost);
}

// An anchor that comes late and contradicts what was followed since: it holds,
// and what is followed goes on from it.
TEST_F(LateAnchorTest, ALateAnchorThatContradictsHolds) {
  constexpr int kLate = 14;
  // The anchor sees the camera a quarter of a metre to the side: its image is
  // exchanged while it waits.
  const Eigen::Vector3d aside(0.25, 0.0, 0.0);
  Localize(0);
  RunWaitingTasks();
  int frame = 1;
  cv::Mat shared;
  for (; tasks_.empty(); ++frame) {
    shared = ImageAt(frame).clone();
    ExpectNear(Localize(frame, shared), frame);
    ASSERT_LT(frame, 60);
  }
  geometry::Rigid3 elsewhere = TruthAt(frame - 1);
  elsewhere.translation += aside;
  place_->Render(elsewhere).copyTo(shared);
  for (const int end = frame + kLate; frame < end; ++frame) {
    const LocalizationResult result = Localize(frame);
    ExpectNear(result, frame);
    ASSERT_EQ(result.reset_count, 1U);
    ASSERT_EQ(tasks_.size(), 1U);
  }
  RunWaitingTasks();
  for (const int end = frame + 10; frame < end; ++frame) {
    const LocalizationResult result = Localize(frame);
    ASSERT_EQ(result.state, CameraState::kTracked) << frame;
    EXPECT_EQ(result.reset_count, 2U);
    EXPECT_LT((result.world_from_camera->translation -
               TruthAt(frame).translation - aside)
                  .norm(),
              0.06)
        << frame;
  }
  // The next one brings it back.
  while (tasks_.empty()) Localize(frame++);
  RunWaitingTasks();
  const LocalizationResult result = Localize(frame);
  ExpectNear(result, frame);
  EXPECT_EQ(result.reset_count, 3U);
}

}  // namespace
}  // namespace groundlock::localization
