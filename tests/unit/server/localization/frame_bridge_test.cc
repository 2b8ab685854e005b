// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/frame_bridge.h"

#include <gtest/gtest.h>

#include <cmath>

namespace groundlock::localization {
namespace {

constexpr double kTurn_rad = 0.01;

Eigen::Quaterniond Turn(double angle_rad) {
  return Eigen::Quaterniond(
      Eigen::AngleAxisd(angle_rad, Eigen::Vector3d::UnitY()));
}

image::Frame FrameAt(int index) {
  image::Frame frame;
  frame.sequence = static_cast<std::uint64_t>(index);
  frame.luma = cv::Mat::zeros(64, 64, CV_8UC1);
  return frame;
}

double Angle_rad(const std::optional<Eigen::Quaterniond>& turn) {
  return turn ? turn->angularDistance(Eigen::Quaterniond::Identity())
              : std::nan("");
}

TEST(FrameBridge, KeepsFewFramesAndTheWholeTurn) {
  FrameBridge bridge;
  bridge.Begin(/*before_known=*/true);
  for (int frame = 1; frame <= 301; ++frame) {
    bridge.Add(FrameAt(frame), Turn(kTurn_rad));
    ASSERT_LT(bridge.steps().size(), FrameBridge::kMaxFrames);
    // Whatever was dropped, the steps' turns add up to the way.
    double angle_rad = Angle_rad(bridge.turn_since_last_step());
    for (const FrameBridge::Step& step : bridge.steps()) {
      angle_rad += Angle_rad(step.before_from_now);
    }
    ASSERT_NEAR(angle_rad, kTurn_rad * frame, 1e-6) << frame;
  }
  // Evenly spread.
  ASSERT_GE(bridge.steps().size(), FrameBridge::kMaxFrames / 2 - 1);
  for (std::size_t i = 0; i < bridge.steps().size(); ++i) {
    EXPECT_EQ(bridge.steps()[i].frame.sequence, 16 * (i + 1));
  }
}

TEST(FrameBridge, LargeFramesAreFewer) {
  FrameBridge bridge;
  bridge.Begin(/*before_known=*/true);
  for (int index = 1; index <= 30; ++index) {
    image::Frame frame;
    frame.luma = cv::Mat::zeros(3'000, 4'000, CV_8UC1);
    bridge.Add(frame, Turn(kTurn_rad));
    ASSERT_FALSE(bridge.steps().empty());
    std::size_t bytes = 0;
    double angle_rad = Angle_rad(bridge.turn_since_last_step());
    for (const FrameBridge::Step& step : bridge.steps()) {
      for (const cv::Mat& level : step.frame.Pyramid()->levels) {
        bytes += level.total();
      }
      angle_rad += Angle_rad(step.before_from_now);
    }
    ASSERT_LE(bytes, FrameBridge::kMaxBytes);
    ASSERT_NEAR(angle_rad, kTurn_rad * index, 1e-6) << index;
  }
}

TEST(FrameBridge, KnowsWhereATurnIsNotKnown) {
  FrameBridge bridge;
  bridge.Begin(/*before_known=*/false);
  bridge.Add(FrameAt(1), Turn(kTurn_rad));
  bridge.Add(FrameAt(2), Turn(kTurn_rad));
  bridge.Add(FrameAt(3), std::nullopt);
  bridge.Add(FrameAt(4), Turn(kTurn_rad));
  ASSERT_EQ(bridge.steps().size(), 4U);
  EXPECT_FALSE(bridge.steps()[0].before_from_now);
  EXPECT_NEAR(Angle_rad(bridge.steps()[1].before_from_now), kTurn_rad, 1e-9);
  EXPECT_FALSE(bridge.steps()[2].before_from_now);
  EXPECT_NEAR(Angle_rad(bridge.steps()[3].before_from_now), kTurn_rad, 1e-9);
  EXPECT_NEAR(Angle_rad(bridge.turn_since_last_step()), 0.0, 1e-9);
  bridge.Begin(/*before_known=*/true);
  EXPECT_TRUE(bridge.steps().empty());
}

}  // namespace
}  // namespace groundlock::localization
