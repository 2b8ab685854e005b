// SPDX-License-Identifier: Apache-2.0
// A map under construction: what importers produce and WriteMapFile consumes.
#ifndef GROUNDLOCK_MAP_STORE_MAP_MAP_DATA_H_
#define GROUNDLOCK_MAP_STORE_MAP_MAP_DATA_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/ground_relief.h"

namespace groundlock::map {

// RootSIFT (Arandjelovic & Zisserman 2012): SIFT, L1-normalised, square root,
// times 512, rounded to 8 bits; COLMAP's form. Importers convert to it.
using Descriptor = std::array<std::uint8_t, 128>;

// One mapping image and the features of it that observe a landmark.
struct MapViewData {
  std::string name;          // the image's file name
  std::uint32_t camera = 0;  // index into MapData::cameras
  geometry::Rigid3 camera_from_world;
  // Per feature, all of one size (descriptors may be empty for the whole map):
  std::vector<Eigen::Vector2f> keypoints_px;  // first pixel's centre (0.5, 0.5)
  std::vector<std::uint32_t> landmarks;       // index into MapData::landmarks
  std::vector<Descriptor> descriptors;
};

struct MapLandmarkData {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  std::array<std::uint8_t, 3> rgb{};
  float error_px = 0.0F;  // mean reprojection error given by the source, or 0
};

// How much is known of the ground.
enum class GroundState : std::uint8_t {
  kUnknown,    // nothing stands on it
  kEstimated,  // from the map itself: its tilt may be off by sigma_rad
  kMeasured,   // given with the world (an alignment, known poses, control
               // points)
};

// Up in world as something else than the ground tells it (measured_up.h).
struct MeasuredUp {
  Eigen::Vector3d up_world = Eigen::Vector3d::UnitZ();  // unit
  double sigma_rad = 0.0;  // 1 sigma about any axis across it; at most 5 deg
  std::string basis;       // "the attitudes of 32 photos", for messages
};

struct MapData {
  std::string source_format;  // "colmap", "nvm", ...
  std::vector<geometry::CameraModel> cameras;
  std::vector<MapViewData> views;
  std::vector<MapLandmarkData> landmarks;
  // The transform that was applied to the source's coordinates.
  geometry::Similarity3 world_from_source;
  // True if world is in metres (an alignment was given), else in map units.
  bool metric = false;
  // Set if world is georeferenced: x east, y north and z up here. Then it is
  // metric.
  std::optional<geometry::GeodeticPosition> origin;
  // In world; z = 0 unless an alignment put the ground elsewhere.
  geometry::Plane ground;
  // Whoever puts data into a world says what it knows of the ground.
  GroundState ground_state = GroundState::kEstimated;
  // 1 sigma of the plane's tilt about any axis in it; 0 = not stated.
  double ground_sigma_rad = 0.0;
  // 1 sigma of the cameras' mean height above it, as a share of that height;
  // 0 = not stated.
  double ground_height_sigma = 0.0;
  // Heights over `ground` that were given with the world (a terrain); empty:
  // the landmarks tell them when the map is written.
  GroundRelief given_relief;
  // Evidence of the ground, for as long as that is looked for. Map files do not
  // hold it.
  std::optional<MeasuredUp> measured_up;
  // False as long as coordinates are those of a foreign reconstruction, whose
  // up and ground nobody knows.
  bool in_world = false;

  bool has_descriptors() const {
    for (const MapViewData& view : views) {
      if (!view.descriptors.empty()) return true;
    }
    return false;
  }
  // Every index in range, sizes consistent, numbers finite, poses unit
  // quaternions. kInvalidArgument names the view, feature or landmark.
  absl::Status Validate() const;
  // Moves everything to a new world and composes world_from_source. `origin`
  // stays as it is: whoever moves a georeferenced world knows its new one. A
  // given relief goes along as long as the world is not turned or scaled; else
  // it is dropped, for its grid is of the old one's axes.
  void Transform(const geometry::Similarity3& new_world_from_world);
};

// Mean reprojection error, px, over all observations that project (COLMAP's
// figure is the mean over landmarks of each one's mean), and their number.
// `data` must be valid.
struct ReprojectionStatistics {
  std::size_t num_observations = 0;
  std::size_t num_behind_camera = 0;  // or beyond the lens model's radius
  double mean_error_px = 0.0;
};
ReprojectionStatistics ComputeReprojection(const MapData& data);

// In a metric world with z up and the ground near z = 0: the plane that
// landmarks near z = 0 support, if it is close to z = 0 (tilt below 3 degrees,
// less than 0.25 m above or below it where those landmarks are) and clearly
// fits more of them; else z = 0. `data` must be valid.
geometry::Plane FitGroundNearZero(const MapData& data);

// A given alignment: world is metric with z up and the ground near z = 0, where
// FitGroundNearZero looks for it. Sets metric, world_from_source and ground.
// kInvalidArgument unless the similarity is finite with positive scale.
absl::Status AlignToWorld(const geometry::Similarity3& world_from_source,
                          MapData& data);

struct GroundEstimate {
  geometry::Plane
      ground_source;  // before the transform; normal towards cameras
  Eigen::Vector3d seed_source;
  int num_inliers = 0;
  double mean_distance = 0.0;  // source units
  // 1 sigma of the normal about any axis in the plane, against the next best
  // explanations.
  double sigma_rad = 0.0;
  // The cameras' mean height above it and 1 sigma of that, source units.
  double height = 0.0;
  double height_sigma = 0.0;
  // The latter over the former; 0 if there is none.
  double height_sigma_share() const;
  // Why nothing should stand on it; empty if nothing speaks against it.
  std::string doubt;
  // MeasuredUp::basis if up was measured; empty if it was taken from the ways
  // that cameras are held.
  std::string up_basis;
};

// Without an alignment: finds a seed point on the ground below the cameras by
// itself, estimates the ground plane around it (Robinson 2014, §3.6.1) and
// moves the map so that the ground is z = 0, z up, scale kept. A measured_up
// tells which planes may be ground (they slope by less than 34 degrees); where
// the map alone is sure of another plane, both are doubted.
// kFailedPrecondition if there are too few landmarks for a plane.
absl::StatusOr<GroundEstimate> AlignToEstimatedGround(std::uint64_t seed,
                                                      MapData& data);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_MAP_DATA_H_
