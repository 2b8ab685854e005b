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
#include <variant>
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

enum class GroundState { kUnknown, kEstimated, kMeasured };

struct MapInfo {
  std::string name;
  std::uint64_t version = 0;
  std::string content_hash;
  std::chrono::system_clock::time_point create_time;
  std::string source_format;
  bool metric = false;
  geometry::Similarity3 world_from_source;
  geometry::Plane ground_world;
  GroundState ground_state = GroundState::kUnknown;
  double ground_sigma_deg = 0.0;  // 0 = not stated
  // 1 sigma of the cameras' mean height above it, as a share of that height;
  // 0 = not stated.
  double ground_height_sigma = 0.0;
  // By how much the heights of the ground differ; 0 = it is the plane.
  double ground_relief_m = 0.0;
  bool ground_relief_given = false;  // by a terrain, not by the landmarks
  std::optional<geometry::CameraModel> lens;  // of all views
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

struct BuildRequest {
  std::string name;
  std::vector<LocalFile> files;
  // The video among the remote paths; empty = the files are photos, taken in
  // the order of their names, and none lies in a folder.
  std::string video_path;
  std::optional<geometry::CameraModel> camera;  // unset = estimated
  std::uint32_t max_images = 0;                 // of a video; 0 = no limit
  std::uint32_t max_features = 0;  // per image; 0 = the server's default
  std::uint64_t seed = 0;
};

struct BuildReport {
  MapInfo map;
  std::vector<std::string> warnings;
  std::string report_json;  // as `groundlock map build --json` prints it
};

// A point of the map: its position in the present world, or pixels of it in two
// or more mapping images.
struct MapPoint {
  struct Pixel {
    std::string image;
    Eigen::Vector2d xy_px = Eigen::Vector2d::Zero();
  };
  std::optional<Eigen::Vector3d> position_world;
  std::vector<Pixel> pixels;
};

// A measured place: in the new world, or on Earth.
using Place = std::variant<Eigen::Vector3d, geometry::GeodeticPosition>;

struct AlignRequest {
  struct FromSource {
    geometry::Similarity3 new_world_from_source;
  };
  struct FromWorld {
    geometry::Similarity3 new_world_from_world;
  };
  struct KnownDistance {
    MapPoint from;
    MapPoint to;
    double distance_m = 0.0;
  };
  struct ControlPoint {
    std::string name;
    MapPoint point;
    Place place;
  };
  struct CameraPosition {
    std::string image;
    Place place;
  };
  struct CameraPositions {
    std::vector<CameraPosition> positions;
    double accuracy_m = 0.0;  // 0 = the server's default
  };
  struct AutomaticGround {};
  // Heights of the ground in the present world, on a regular grid over x and y.
  struct Terrain {
    Eigen::Vector2d first_m = Eigen::Vector2d::Zero();  // of the first height
    double step_m = 1.0;
    std::uint32_t columns = 0;  // along x
    // Row by row along y, at most 250,000; NaN = unknown.
    std::vector<float> z_m;
    double sigma_m = 0.0;  // 0 = as the map's own ground scatters about them
    // Move it up or down to the ground that the landmarks show.
    bool fit_height = false;
  };

  std::string name;
  std::uint64_t version = 0;  // 0 = newest
  // monostate: only the ground moves the map.
  std::variant<std::monostate,
               FromSource,
               FromWorld,
               KnownDistance,
               std::vector<ControlPoint>,
               CameraPositions>
      method;
  std::optional<geometry::GeodeticPosition> origin;
  // Present world: a point on the ground, its plane, or (without a method) its
  // heights.
  std::variant<std::monostate,
               AutomaticGround,
               Eigen::Vector3d,
               geometry::Plane,
               Terrain>
      ground;
  std::uint64_t seed = 0;
  bool report_only = false;
};

struct AlignReport {
  struct Residual {
    std::string name;
    Eigen::Vector3d error_m = Eigen::Vector3d::Zero();  // aligned - measured
    bool used = true;
  };
  MapInfo map;
  geometry::Similarity3 new_world_from_world;
  std::vector<Residual> residuals;
  double rms_error_m = 0.0;
  double rms_horizontal_error_m = 0.0;
  double median_error_m = 0.0;
  double max_error_m = 0.0;
  struct TerrainAgreement {
    double offset_m = 0.0;   // the map's ground over the terrain
    double scatter_m = 0.0;  // 1 sigma about it
    std::uint64_t num_ground = 0;
    std::uint64_t num_landmarks = 0;
  };
  std::optional<TerrainAgreement> terrain;
  std::vector<std::string> warnings;
};

struct MapCheck {
  MapInfo map;
  std::vector<std::string> problems;  // empty = the map is sound
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
