// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/frame_bridge.h"

#include <utility>

namespace groundlock::localization {

std::optional<Eigen::Quaterniond> Chain(
    const std::optional<Eigen::Quaterniond>& a_from_b,
    const std::optional<Eigen::Quaterniond>& b_from_c) {
  if (!a_from_b || !b_from_c) return std::nullopt;
  return (*a_from_b * *b_from_c).normalized();
}

void FrameBridge::Begin(bool before_known) {
  steps_.clear();
  turn_since_last_step_.reset();
  if (before_known) turn_since_last_step_ = Eigen::Quaterniond::Identity();
  num_added_ = 0;
  stride_ = 1;
}

void FrameBridge::Add(
    const image::Frame& frame,
    const std::optional<Eigen::Quaterniond>& before_from_now) {
  turn_since_last_step_ = Chain(turn_since_last_step_, before_from_now);
  if (++num_added_ % stride_ != 0) return;
  // The pyramid alone is looked at; its first level is the luma.
  steps_.push_back(
      {frame,
       std::exchange(turn_since_last_step_, Eigen::Quaterniond::Identity())});
  image::Frame& kept = steps_.back().frame;
  kept.colour.reset();
  kept.luma = kept.Pyramid()->levels.front();
  while (steps_.size() >= kMaxFrames ||
         (steps_.size() > 1 && num_bytes() > kMaxBytes)) {
    DropEverySecond();
  }
}

std::size_t FrameBridge::num_bytes() const {
  std::size_t bytes = 0;
  for (const Step& step : steps_) {
    for (const cv::Mat& level : step.frame.Pyramid()->levels) {
      bytes += level.total() * level.elemSize();
    }
  }
  return bytes;
}

void FrameBridge::DropEverySecond() {
  stride_ *= 2;
  std::vector<Step> kept;
  for (std::size_t i = 1; i < steps_.size(); i += 2) {
    kept.push_back(
        {std::move(steps_[i].frame),
         Chain(steps_[i - 1].before_from_now, steps_[i].before_from_now)});
  }
  if (steps_.size() % 2 == 1) {
    turn_since_last_step_ =
        Chain(steps_.back().before_from_now, turn_since_last_step_);
  }
  steps_ = std::move(kept);
}

}  // namespace groundlock::localization
