// SPDX-License-Identifier: Apache-2.0
// A video's keyframes as image files.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_FRAMES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_FRAMES_H_

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/keyframes.h"

namespace groundlock::build::internal {

// "frame_000123.jpg".
std::string KeyframeName(const Keyframe& keyframe);

// Reads the video to choose, up to three times with half the spacing if that
// gives few keyframes, then once more to write them into `folder`, which is
// emptied before, and to follow points from one to the next.
// progress(fraction); false cancels. kNotFound, kInvalidArgument (no video, a
// single frame, frames of several sizes, or nothing to see in it: the message
// names the frame).
struct ChosenKeyframes {
  std::vector<Keyframe> keyframes;
  std::size_t num_left_out = 0;  // to keep to max_keyframes
};
absl::StatusOr<ChosenKeyframes> ExtractKeyframes(
    const std::filesystem::path& video,
    const KeyframeOptions& options,
    std::size_t max_keyframes,
    const std::filesystem::path& folder,
    const std::function<bool(double)>& progress,
    FeatureTracks* tracks);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_FRAMES_H_
