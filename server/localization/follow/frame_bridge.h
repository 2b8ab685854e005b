// SPDX-License-Identifier: Apache-2.0
// Frames between the one whose pose is sought and the one in which it is found.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRAME_BRIDGE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRAME_BRIDGE_H_

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "server/image/frame.h"

namespace groundlock::localization {

// Keeps frames, of which landmarks can be followed from one to the next, and
// how the camera turned in between, also over frames that are not kept: at most
// kMaxFrames, and no more than kMaxBytes of pixels beside the newest, however
// long it takes; when there are so many, every second goes. Not thread-safe.
class FrameBridge {
 public:
  static constexpr std::size_t kMaxFrames = 24;
  // As many frames of 1920 x 1080, of which a pyramid takes 2.8 MiB.
  static constexpr std::size_t kMaxBytes = std::size_t{72} << 20;

  struct Step {
    image::Frame frame;  // luma and pyramid alone
    // Of the step before (of the first: where the bridge begins); nullopt if
    // the image did not tell.
    std::optional<Eigen::Quaterniond> before_from_now;
  };

  // Begins anew; `before_known`: the frame whose pose is sought comes just
  // before the first one added.
  void Begin(bool before_known);
  // The next frame, and how the camera turned since the frame before.
  void Add(const image::Frame& frame,
           const std::optional<Eigen::Quaterniond>& before_from_now);
  const std::vector<Step>& steps() const { return steps_; }
  // From the last step to the last frame that was added.
  const std::optional<Eigen::Quaterniond>& turn_since_last_step() const {
    return turn_since_last_step_;
  }

 private:
  friend struct StateFields;

  void DropEverySecond();
  std::size_t num_bytes() const;

  std::vector<Step> steps_;
  std::optional<Eigen::Quaterniond> turn_since_last_step_;
  std::uint64_t num_added_ = 0;
  std::uint64_t stride_ = 1;  // frames from step to step
};

// a_from_c of a_from_b and b_from_c; nullopt if either is.
std::optional<Eigen::Quaterniond> Chain(
    const std::optional<Eigen::Quaterniond>& a_from_b,
    const std::optional<Eigen::Quaterniond>& b_from_c);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRAME_BRIDGE_H_
