// SPDX-License-Identifier: Apache-2.0
// From a video or photos to a map. COLMAP's programs do the structure from
// motion as child processes; choosing frames, features, pairs and the right
// sub-model, filtering, and the report are ours.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_BUILD_H_
#define GROUNDLOCK_MAP_STORE_BUILD_BUILD_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/build/keyframes.h"
#include "map_store/build/report.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/map/map_data.h"

namespace groundlock::build {

struct BuildProgress {
  std::string_view stage;  // "frames", "features", "matching", "verifying",
                           // "mapping", "refining", "finishing"
  double fraction = 0.0;   // of this stage, 0 to 1
  std::string note;        // say, "32 of 72 images"
};
// Called from the calling thread, several times a second; false cancels.
using ProgressCallback = std::function<bool(const BuildProgress&)>;

enum class FeatureKind {
  kGroundlock,  // as the localiser finds them in frames
  kColmap,      // COLMAP's own extractor: several times slower
};

struct BuildOptions {
  // One of the two.
  std::filesystem::path video;
  std::filesystem::path images;  // a folder; the order of names is that of time
  // Everything on the way lies here, and the result; made if absent. A build
  // that was interrupted goes on from what is here; other inputs or options
  // make the stages that depend on them run anew.
  std::filesystem::path work_folder;
  // Kept as it is; unset = SIMPLE_RADIAL, estimated along with the map.
  std::optional<geometry::CameraModel> camera;
  KeyframeOptions keyframes;
  std::size_t max_images = 1'000;  // of a video; 0 = no limit
  FeatureKind features = FeatureKind::kGroundlock;
  int max_features = 6'000;  // per image
  int min_views = 3;         // landmarks seen in fewer images are left out
  int threads = 0;           // 0 = all cores
  int niceness = 0;          // of COLMAP's programs, added to ours
  // Address space of each of COLMAP's programs; 0 = as much as the machine has
  // memory.
  std::uint64_t memory_bytes = 0;
  std::uint64_t seed = 0;
  std::string colmap = "colmap";  // the program
  absl::Status Validate() const;  // names field, value and bound
};

struct BuildResult {
  // A COLMAP model with its database.db, as formats::Import reads it; its
  // coordinates are arbitrary. In the work folder, as the report is:
  // report.html, report.json, map_above.png, map_side.png, coverage.png.
  std::filesystem::path model;
  BuildReport report;
};

// kInvalidArgument (options, inputs), kNotFound (an input, or no COLMAP),
// kCancelled, kFailedPrecondition (what was filmed makes no map, or another
// build works in the folder): messages say what to do. Blocks; uses all cores.
absl::StatusOr<BuildResult> Build(const BuildOptions& options,
                                  const ProgressCallback& progress);

}  // namespace groundlock::build

#endif  // GROUNDLOCK_MAP_STORE_BUILD_BUILD_H_
