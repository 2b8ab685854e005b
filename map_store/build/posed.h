// SPDX-License-Identifier: Apache-2.0
// From images whose poses are known (RTK, another tracker, a total station) to
// a map, without structure from motion.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_POSED_H_
#define GROUNDLOCK_MAP_STORE_BUILD_POSED_H_

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/build/build.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::build {

struct PosedImage {
  std::string name;  // the image's file name
  geometry::Rigid3 world_from_camera;
  std::optional<geometry::CameraModel> camera;  // unset = PosedOptions::camera
};

// Reads poses from
//   a CSV file with a header line and the columns name (or image), x, y, z,
//     qw, qx, qy, qz (world_from_camera; other columns are left alone), or
//   a JSON array of {"image", "centre_m" [x,y,z], "world_from_camera_wxyz",
//     and, if each has its own, "width", "height", "model", "params"}.
// kInvalidArgument names the line or the entry, and the field.
absl::StatusOr<std::vector<PosedImage>> ReadPoses(
    const std::filesystem::path& path);

struct PosedOptions {
  std::filesystem::path images;   // folder
  std::vector<PosedImage> poses;  // images without a pose are left out
  std::optional<geometry::CameraModel> camera;
  // How far a pose may be off (1 sigma); 0 = exactly right, and not adjusted.
  double sigma_m = 0.0;
  double sigma_rad = 0.0;
  int max_features = 8'000;       // per image
  int min_views = 2;              // landmarks seen in fewer images are left out
  int threads = 0;                // 0 = all cores
  absl::Status Validate() const;  // names field, value and bound
};

struct PosedResult {
  map::MapData data;  // in the poses' world, metric; not aligned further
  BuildReport report;
};

// Stages "features", "matching", "triangulating", "adjusting".
// kFailedPrecondition if hardly anything could be triangulated: poses and
// images do not fit together.
absl::StatusOr<PosedResult> BuildFromPoses(const PosedOptions& options,
                                           const ProgressCallback& progress);

}  // namespace groundlock::build

#endif  // GROUNDLOCK_MAP_STORE_BUILD_POSED_H_
