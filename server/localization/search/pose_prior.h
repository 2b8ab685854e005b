// SPDX-License-Identifier: Apache-2.0
// What other sensors say about where the camera is.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_POSE_PRIOR_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_POSE_PRIOR_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"

namespace groundlock::localization {

// Narrows the search while the camera is sought: a wrong one costs time, not
// the result. While a pose is known it is a measurement of it, which counts
// little beside what the map says; one that contradicts what is known is left
// out.
struct PosePrior {
  // Of the sensor, in world or, if the map has an origin, on the Earth; not
  // both. Its standard deviation per axis, > 0.
  std::optional<Eigen::Vector3d> position_world;
  std::optional<geometry::GeodeticPosition> geodetic_position;
  double position_sigma = 0.0;
  // Where the sensor of the position is fixed to the camera (the arm from the
  // lens to the antenna), in camera; unit of the map.
  Eigen::Vector3d position_arm_camera = Eigen::Vector3d::Zero();
  // world_from_camera, and its standard deviation about each axis, > 0.
  std::optional<Eigen::Quaterniond> rotation;
  double rotation_sigma_rad = 0.0;

  // kInvalidArgument names the field.
  absl::Status Validate() const;
  // Of the camera's centre; set if position and rotation are.
  std::optional<geometry::Rigid3> world_from_camera() const;
};

// The same with the position in world. kFailedPrecondition: it is on the Earth,
// and the map has no origin.
absl::StatusOr<PosePrior> PlaceInWorld(const map::Map& map, PosePrior prior);

// Per map view: could it show what the camera sees? Views within three standard
// deviations of the prior and looking within 60 degrees and three standard
// deviations of its direction, but at least the eight nearest of these
// directions. All, if the prior has no position. Thread-safe.
std::vector<bool> ViewsNearPrior(const map::Map& map, const PosePrior& prior);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_POSE_PRIOR_H_
