// SPDX-License-Identifier: Apache-2.0
// What a user should know about a map that was built.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_REPORT_H_
#define GROUNDLOCK_MAP_STORE_BUILD_REPORT_H_

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "map_store/geometry/plane.h"
#include "map_store/map/map_data.h"

namespace groundlock::build {

struct ImageReport {
  std::string name;
  bool is_registered = false;
  int num_features = 0;
  int num_landmarks = 0;  // that it sees
  double sharpness = 0.0;
  bool is_blurred = false;  // far below its neighbours
};

struct StageReport {
  std::string name;
  double wall_s = 0.0;
  double cpu_s = 0.0;      // with COLMAP's
  bool was_there = false;  // from an earlier, interrupted build
};

struct BuildReport {
  std::vector<ImageReport> images;  // in the order of time
  int num_registered = 0;
  std::size_t num_landmarks = 0;
  std::size_t num_observations = 0;
  double mean_track_length = 0.0;  // images per landmark
  double mean_reprojection_error_px = 0.0;
  std::vector<std::string> cameras;  // as camera.json has them
  // 1 sigma of the focal length where the lens was found along with the map.
  std::optional<double> focal_sigma_px;
  // In the model's coordinates, normal towards the cameras; unset if it is
  // unknown, for the reason in ground_doubt.
  std::optional<geometry::Plane> ground;
  double ground_sigma_deg = 0.0;  // 1 sigma of its tilt
  // 1 sigma of the cameras' mean height above it, over that height.
  double ground_height_sigma = 0.0;
  std::string ground_doubt;
  // What told which way is up: "the attitudes of 32 photos"; empty if the ways
  // that cameras are held did.
  std::string up_basis;
  int num_ground_landmarks = 0;
  int num_with_gps = 0;               // of the images in the map
  std::vector<std::string> warnings;  // each says what to do
  std::vector<StageReport> stages;
};

// Counts, track length, reprojection error, lens and ground of `data`;
// `images` must be filled in.
void DescribeMap(const map::MapData& data,
                 std::uint64_t seed,
                 BuildReport* report);

// Images that fit together badly, blurred ones, neighbours that share too
// little, and stretches where the camera only turned. `data` is the finished
// map, which `report` describes.
std::vector<std::string> FindWeaknesses(const map::MapData& data,
                                        const BuildReport& report);

std::string ReportJson(const BuildReport& report);

// report.json, report.html and its pictures map_above.png, map_side.png and
// coverage.png into `folder`, replacing older ones; and camera.json, if all
// views of `data` have one and the same lens.
absl::Status WriteReport(const BuildReport& report,
                         const map::MapData& data,
                         std::uint64_t seed,
                         const std::string& title,
                         const std::filesystem::path& folder);

}  // namespace groundlock::build

#endif  // GROUNDLOCK_MAP_STORE_BUILD_REPORT_H_
