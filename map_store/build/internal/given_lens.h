// SPDX-License-Identifier: Apache-2.0
// Whether a lens that somebody gave is the one that a video was filmed with.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_GIVEN_LENS_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_GIVEN_LENS_H_

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/internal/track_motion.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::build::internal {

// The lens that the tracks ask for, where it is another than the given one.
struct OtherLens {
  double given_focal_px = 0.0;  // mean of both axes
  double focal_px = 0.0;
  double focal_sigma_px = 0.0;

  std::string ToText() const;  // a warning to whoever gave the lens
};

// Reconstructs the motion as if nobody had told the focal length, with the
// given distortion taken out of the tracks, and as if nobody had told that
// either, and compares: a lens that is kept bends the motion until it fits, and
// neither residuals nor keyframes that hold together tell of it. nullopt if one
// of the two agrees with the given lens, if that explains the tracks as well,
// or if nothing tells.
//   given_scene  what the given lens made of the tracks; null if nothing
//   options      its camera is the given lens
// kCancelled. Deterministic. Thread-safe.
absl::StatusOr<std::optional<OtherLens>> FindOtherLens(
    const FeatureTracks& tracks,
    const TrackScene* given_scene,
    const MotionOptions& options);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_GIVEN_LENS_H_
