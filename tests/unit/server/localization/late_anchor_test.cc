// SPDX-License-Identifier: Apache-2.0
// Anchors that arrive many frames after the one they were asked in, as on a
// machine that is busy: the camera is found and stays so.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <functional>
#include <memory>
#include <utility>

#include "server/localization/localizer.h"
#include "tests/support/rendered_plane_map.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using std::chrono::milliseconds;

class LateAnchorTest : public testing::Test {
 protected:
  // A walk to and fro before the wall: up to 1.3 m/s and 0.3 rad/s.
  static Rigid3 TruthAt(int frame) {
    const double phase = 0.06 * frame;
    return test_support::LookAlongY({1.0 * std::sin(0.9 * phase),
                                     0.25 * std::sin(0.7 * phase),
                                     1.65 + 0.08 * std::sin(1.7 * phase)},
                                    0.1 * std::sin(1.3 * phase + 0.5),
                                    -0.03 + 0.04 * std::sin(1.1 * phase));
  }

  static LocalizerOptions LateOptions() {
    LocalizerOptions options;
    options.wait_for_anchor = false;
    return options;
  }
  LocalizationResult Localize(int frame) {
    return Localize(frame, place_.Render(TruthAt(frame)));
  }
  LocalizationResult Localize(int frame, const cv::Mat& luma) {
    image::Frame input;
    input.sequence = static_cast<std::uint64_t>(frame);
    input.capture_time = frame * milliseconds(42);
    input.luma = luma;
    const auto result = localizer_->Localize({&input, place_.camera(), {}});
    EXPECT_TRUE(result.ok()) << result.status();
    return result.value_or(LocalizationResult());
  }
  void RunWaitingTasks() {
    while (!tasks_.empty()) {
      tasks_.front()();
      tasks_.pop_front();
    }
  }
  void ExpectNear(const LocalizationResult& result, int frame) const {
    ASSERT_EQ(result.state, CameraState::kTracked) << frame;
    // As in fast_localizer_test.cc.
    EXPECT_LT(
        test_support::CenterError(*result.world_from_camera, TruthAt(frame)),
        0.03)
        << frame;
  }

  test_support::RenderedPlace place_{1};
  std::shared_ptr<const map::Map> map_ = test_support::OpenTemporaryMap(
      MapFromViews(place_, test_support::MappingViews()));
  std::deque<std::function<void()>> tasks_;
  std::unique_ptr<Localizer> localizer_ = *CreateLocalizer(
      "fast", map_, LateOptions(), [this](Urgency, std::function<void()> task) {
        tasks_.push_back(std::move(task));
      });
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
  const cv::Mat wall(
      place_.Render(TruthAt(0)).size(), CV_8UC1, cv::Scalar(128));
  int frame = 0;
  for (int search = 0; search < kInVain; ++search) {
    for (int i = 0; i < kLate; ++i) {
      EXPECT_EQ(Localize(frame++, wall).state, CameraState::kInitializing);
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
  const cv::Mat wall(
      place_.Render(TruthAt(0)).size(), CV_8UC1, cv::Scalar(128));
  Localize(0);
  RunWaitingTasks();
  // Nothing to follow the landmarks in.
  const LocalizationResult held = Localize(10, wall);
  ASSERT_EQ(held.state, CameraState::kHeld);
  EXPECT_EQ(held.reset_count, 1U);
  const double error =
      test_support::CenterError(*held.world_from_camera, TruthAt(0));
  EXPECT_LT(error, 0.03);
  // As far as a camera may have come meanwhile.
  EXPECT_GT(std::sqrt(held.covariance(0, 0)), 0.1);
  EXPECT_EQ(Localize(80, wall).state, CameraState::kLost);
}

}  // namespace
}  // namespace groundlock::localization
