// SPDX-License-Identifier: Apache-2.0
// Bundler's bundle.out (v0.3), its list of images and Lowe's .key files as they
// are. The parsers work on bytes, so that they can be fuzzed.
// Source: Bundler's user's manual (version 0.4), "Output format" and "Scene
// representation"; Lowe's "Demo software: SIFT keypoint detector", README.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BUNDLER_MODEL_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BUNDLER_MODEL_H_

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

struct BundlerCamera {
  double focal_px = 0.0;  // 0 = the image was not registered
  double k1 = 0.0;        // undistorted to distorted, as ours
  double k2 = 0.0;
  geometry::Rigid3 camera_from_world;  // turned to ours: y down, z forward
};

struct BundlerObservation {
  std::uint32_t camera = 0;
  std::uint32_t key = 0;  // index in the image's .key file
  std::uint32_t point = 0;
  // From the image's centre, turned to ours: y down.
  Eigen::Vector2f xy_px;
};

struct BundlerModel {
  std::vector<BundlerCamera> cameras;
  std::vector<map::MapLandmarkData> points;
  std::vector<BundlerObservation> observations;
};

// `file` names the text in messages; errors give the line.
absl::StatusOr<BundlerModel> ParseBundler(std::string_view text,
                                          std::string_view file);

// The images' names, in the order of the cameras. A line is NAME, or NAME 0 F
// with the focal length that EXIF gave.
absl::StatusOr<std::vector<std::string>> ParseBundlerList(
    std::string_view text, std::string_view file);

// A .key file: Lowe's text.
struct KeyFile {
  std::vector<Eigen::Vector2f> xy_px;  // first pixel's centre (0, 0)
  std::vector<std::array<std::uint8_t, 128>> descriptors;  // L2, times 512
};
absl::StatusOr<KeyFile> ParseKeyFile(std::string_view text,
                                     std::string_view file);

// The content of a .gz file. kResourceExhausted if it holds more than
// max_bytes, kInvalidArgument if it is damaged.
absl::StatusOr<std::string> Gunzip(std::string_view bytes,
                                   std::uint64_t max_bytes,
                                   std::string_view file);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BUNDLER_MODEL_H_
