// SPDX-License-Identifier: Apache-2.0
// Giving a map metres, a place on Earth and its ground.
#ifndef GROUNDLOCK_MAP_STORE_MAP_ALIGNMENT_H_
#define GROUNDLOCK_MAP_STORE_MAP_ALIGNMENT_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/given_terrain.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {

// A point of the map, by its position or by where images show it (two or more
// that see it from directions at least kMinParallax_deg apart).
struct MapPoint {
  struct Pixel {
    std::string image;  // name of a view
    Eigen::Vector2d xy_px = Eigen::Vector2d::Zero();
  };
  std::optional<Eigen::Vector3d> p_world;  // the map's present world
  std::vector<Pixel> pixels;
};
inline constexpr double kMinParallax_deg = 1.0;

// A place that was measured: in the new world, or on Earth.
using Place = std::variant<Eigen::Vector3d, geometry::GeodeticPosition>;

// Ways to give a map its world; all places of one request are of one kind.
struct SimilarityFromSource {
  geometry::Similarity3 new_world_from_source;
};
struct SimilarityFromWorld {
  geometry::Similarity3 new_world_from_world;
};
// Sets the scale; the world's axes stay.
struct KnownDistance {
  MapPoint from;
  MapPoint to;
  double distance_m = 0.0;  // > 0
};
// Least squares over all, at least three, not on a line.
struct ControlPoint {
  std::string name;
  MapPoint point;
  Place place;
};
struct ControlPoints {
  std::vector<ControlPoint> points;
};
// Robust against positions that do not fit the others. On a line (a straight
// walk) the map's present z is taken for up.
struct CameraPosition {
  std::string image;  // of no view: skipped; folders may differ
  Place place;
};
struct CameraPositions {
  std::vector<CameraPosition> positions;
  double accuracy_m = 3.0;  // 1 sigma per axis of a good one
};

struct GroundAutomatic {};
struct GroundSeed {
  Eigen::Vector3d p_world;  // on the ground, present world
};
struct GroundPlane {
  geometry::Plane plane_world;  // present world
};

struct AlignmentRequest {
  // monostate: the scale stays, and only the ground moves the map.
  std::variant<std::monostate,
               SimilarityFromSource,
               SimilarityFromWorld,
               KnownDistance,
               ControlPoints,
               CameraPositions>
      method;
  // World will be east, north and up here. Unset, with geodetic places: their
  // middle, at the ground's height.
  std::optional<geometry::GeodeticPosition> origin;
  // monostate: as it is for a distance, else automatic. A ground moves a map
  // so that it becomes z = 0, unless places or a similarity say where the
  // world is: then it only becomes the map's ground. A georeferenced world is
  // moved up or down, never turned.
  // A terrain (heights in the present world) needs a world that is level, and
  // no method beside it.
  std::variant<std::monostate,
               GroundAutomatic,
               GroundSeed,
               GroundPlane,
               GivenTerrain>
      ground;
  std::uint64_t seed = 0;
};

struct AlignmentReport {
  struct Residual {
    std::string name;
    Eigen::Vector3d error_m = Eigen::Vector3d::Zero();  // aligned - measured
    bool used = true;
  };
  geometry::Similarity3 new_world_from_world;
  std::vector<Residual> residuals;
  // Over those used.
  double rms_error_m = 0.0;
  double rms_horizontal_error_m = 0.0;
  double median_error_m = 0.0;
  double max_error_m = 0.0;
  // With a terrain, if there are landmarks to tell: by how much the map's own
  // ground lay over it, and how that scatters.
  std::optional<TerrainAgreement> terrain;
  std::vector<std::string> warnings;
};

// Moves `data` to the world that the request describes. `data` must be valid,
// and is unchanged on an error: kInvalidArgument (names what is wrong, unknown
// images), kFailedPrecondition (what is given does not determine the world, or
// contradicts itself). Deterministic.
absl::StatusOr<AlignmentReport> AlignMap(const AlignmentRequest& request,
                                         MapData& data);

// What an import does with a reconstruction: into the world that is given
// (`origin` is its place on Earth, if any); else, if its source was
// georeferenced, east, north and up with the ground at z = 0; else its ground
// becomes z = 0. A map that is in a world already stays there unless one is
// given. Says in `warnings` what a user should know.
absl::Status PutIntoWorld(
    const std::optional<geometry::Similarity3>& world_from_source,
    const std::optional<geometry::GeodeticPosition>& origin,
    std::uint64_t seed,
    MapData& data,
    std::vector<std::string>& warnings);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_ALIGNMENT_H_
