// SPDX-License-Identifier: Apache-2.0
// The service's maps as plain structs; meaning, units and frames are those of
// proto/groundlock/v1/maps.proto.
#ifndef GROUNDLOCK_CLIENT_SDK_MAP_TYPES_H_
#define GROUNDLOCK_CLIENT_SDK_MAP_TYPES_H_

#include <Eigen/Core>
#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::sdk {

enum class MapFormat {
  kAuto,
  kColmap,
  kNvm,
  kBundler,
  kOpenMvg,
  kOpenSfm,
  kGroundlock
};
enum class MapExportFormat { kColmap, kColmapText, kNvm, kPly, kGroundlock };

struct MapInfo {
  std::string name;
  std::uint64_t version = 0;
  std::string content_hash;
  std::chrono::system_clock::time_point create_time;
  std::string source_format;
  bool metric = false;
  geometry::Similarity3 world_from_source;
  geometry::Plane ground_world;
  std::optional<geometry::GeodeticPosition> origin;
  std::uint64_t num_cameras = 0;
  std::uint64_t num_views = 0;
  std::uint64_t num_landmarks = 0;
  std::uint64_t num_observations = 0;
  double mean_reprojection_error_px = 0.0;
  bool has_descriptors = false;
  std::uint64_t file_bytes = 0;
};

// A file to upload: where it lies here, and its relative path over there.
struct LocalFile {
  std::filesystem::path path;
  std::string remote_path;  // '/'-separated, no ".." parts
};

// What formats::FindImportFiles reports fits in here field by field.
struct ImportRequest {
  std::string name;
  MapFormat format = MapFormat::kAuto;
  std::vector<LocalFile> files;
  // Among the remote paths; empty = none.
  std::string model_path;  // folder or file
  std::string database_path;
  std::string images_path;
  // Makes the map metric; unset = the ground is estimated and becomes z = 0.
  std::optional<geometry::Similarity3> world_from_source;
  // With world_from_source: where its world lies on Earth.
  std::optional<geometry::GeodeticPosition> origin;
  std::uint64_t seed = 0;
};

struct ImportReport {
  MapInfo map;
  std::vector<std::string> warnings;
};

struct MapCamera {
  std::string name;
  geometry::CameraModel camera;
  geometry::Rigid3 world_from_camera;
};

struct PointCloud {
  std::vector<Eigen::Vector3f> xyz_world;
  std::vector<std::array<std::uint8_t, 3>> rgb;  // runs in parallel
  std::vector<MapCamera> cameras;
};

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_MAP_TYPES_H_
