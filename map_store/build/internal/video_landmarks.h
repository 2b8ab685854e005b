// SPDX-License-Identifier: Apache-2.0
// From a video's motion to a map: the landmarks that a localiser finds again.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_LANDMARKS_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_LANDMARKS_H_

#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/track_motion.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// What is left of a TrackMotion between two stages of a build.
struct VideoMotion {
  geometry::CameraModel camera;
  std::optional<double> focal_sigma_px;  // unset: the lens was given
  std::vector<std::optional<geometry::Rigid3>> camera_from_world;  // per image
  std::vector<std::string> notes;  // TrackMotion's
  std::string lens_doubt;  // why a given lens is none of this video; or empty
};
absl::Status WriteMotion(const VideoMotion& motion,
                         const std::filesystem::path& path);
// kDataLoss names what is wrong.
absl::StatusOr<VideoMotion> ReadMotion(const std::filesystem::path& path);

struct LandmarkOptions {
  bool lens_is_known = false;
  int min_views = 3;
  int threads = 1;
  std::function<bool(double)> progress;  // false cancels
};

// Matches features along the epipolar lines of images that look the same way,
// adjusts them together with the tracks, poses and lens, and places images
// that the tracks alone did not. `motion` is updated; the map's views are the
// images that have a pose, its landmarks the features seen often enough.
//   features  one per image of `tracks`
absl::StatusOr<map::MapData> PlaceLandmarks(
    const FeatureTracks& tracks,
    std::span<const ImageFeatures> features,
    const LandmarkOptions& options,
    VideoMotion* motion);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_VIDEO_LANDMARKS_H_
