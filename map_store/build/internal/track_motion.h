// SPDX-License-Identifier: Apache-2.0
// Structure from motion of a video: from tracks to the lens, the cameras'
// poses and the points.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_MOTION_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_MOTION_H_

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/internal/track_scene.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::build::internal {

struct MotionOptions {
  // Kept as it is; unset = SIMPLE_RADIAL, found along with the motion.
  std::optional<geometry::CameraModel> camera;
  int threads = 1;
  // Fraction done, and what is being done; false cancels.
  std::function<bool(double, const std::string&)> progress;
};

struct TrackMotion {
  TrackScene scene;
  geometry::CameraModel camera;
  // 1 sigma; unset if the lens was given.
  std::optional<double> focal_sigma_px;
  std::uint32_t num_tries = 0;  // starts that were carried on
  // For whoever built it: what was given up and what was done instead, and what
  // the map hangs on.
  std::vector<std::string> notes;
};

// What a start led to. One that went wrong (a lens that is off, a stretch that
// moves by itself) may hold all keyframes, too, but explains less.
struct MotionTry {
  std::uint32_t num_posed = 0;
  std::uint32_t num_images = 0;
  double trimmed_cost_px2 = 0.0;  // TrackScene's

  bool IsGoodEnough() const;  // no other start need be tried
  bool IsBetterThan(const MotionTry& other) const;

 private:
  bool HoldsEnough() const;
};

// Starts from the pairs of keyframes that open the widest parallax over many
// tracks, with several focal lengths each, keeps the start that explains its
// stretch best, and adds keyframe after keyframe. Where a try holds too few of
// the keyframes, or leaves more of the tracks than their noise, the next start
// is tried; the one that holds most is kept, of those that hold enough the one
// that explains the tracks best.
// kFailedPrecondition if nothing held three keyframes together with a lens that
// a camera may have; kCancelled.
// Deterministic.
// Source: Hartley & Zisserman, 2nd ed., chapters 9 to 12, 18; Pollefeys et al.
// 2004 (video without a known lens).
absl::StatusOr<TrackMotion> ReconstructMotion(const FeatureTracks& tracks,
                                              const MotionOptions& options);

// Adds image after image to a scene that has begun, the one that sees most
// placed points next, and adjusts as it grows; until no more can be placed. The
// lens is adjusted along at the end. `progress` is told what has been done, ""
// in between; false cancels: kCancelled.
absl::Status GrowScene(int threads,
                       const std::function<bool(const std::string&)>& progress,
                       TrackScene& scene);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_MOTION_H_
