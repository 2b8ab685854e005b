// SPDX-License-Identifier: Apache-2.0
// Maps that grow: by new images, and by other maps.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_GROW_H_
#define GROUNDLOCK_MAP_STORE_BUILD_GROW_H_

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/build/build.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/map_data.h"

namespace groundlock::build {

struct ExtendOptions {
  std::filesystem::path images;  // folder with the new images
  // Their lens; unset = the map's own of that image size.
  std::optional<geometry::CameraModel> camera;
  int max_features = 8'000;  // per image
  int min_inliers = 30;      // landmarks that must agree on an image's pose
  int threads = 0;           // 0 = all cores
  std::uint64_t seed = 0;
};

struct ExtendReport {
  std::vector<std::string> registered;
  std::vector<std::string> not_registered;
  std::size_t num_new_observations = 0;  // of landmarks that were there
  std::size_t num_new_landmarks = 0;
  double mean_reprojection_error_px = 0.0;  // over all of the map
};

// Finds the images in the map, adds them as views, triangulates what only they
// see, and adjusts the new poses and landmarks; what was there stays where it
// is, with its alignment. Stages "features", "registering", "triangulating",
// "adjusting".
// kFailedPrecondition: a map without descriptors, or no image found its place.
absl::StatusOr<ExtendReport> ExtendMap(const ExtendOptions& options,
                                       const ProgressCallback& progress,
                                       map::MapData* data);

struct MergeOptions {
  double max_error_px = 6.0;  // of a common landmark in a view of the first map
  int min_common_landmarks = 30;
  std::uint64_t seed = 0;
  int threads = 0;  // 0 = all cores
};

struct MergeReport {
  geometry::Similarity3 first_from_second;
  int num_candidates = 0;        // landmarks that look the same
  int num_common_landmarks = 0;  // that also lie in the same place: fused
  double median_error_px = 0.0;  // of these, before they were fused
  double median_distance = 0.0;  // in the first map's unit
};

// Brings `second` into the world of `first` by a similarity that their common
// landmarks agree on, fuses those and adjusts the second map's part. Views of
// one name are told apart by a prefix. The alignment is that of `first`.
// kFailedPrecondition if the maps have too little in common, or no descriptors.
absl::StatusOr<MergeReport> MergeMaps(const map::MapData& second,
                                      const MergeOptions& options,
                                      const ProgressCallback& progress,
                                      map::MapData* first);

}  // namespace groundlock::build

#endif  // GROUNDLOCK_MAP_STORE_BUILD_GROW_H_
