// SPDX-License-Identifier: Apache-2.0
// The ground that an alignment was asked for.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CHOSEN_GROUND_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CHOSEN_GROUND_H_

#include <Eigen/Core>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "map_store/geometry/plane.h"
#include "map_store/map/alignment.h"
#include "map_store/map/internal/world_solution.h"

namespace groundlock::map::internal {

// A ground in the present world, and how sure it is.
struct ChosenGround {
  std::optional<geometry::Plane> plane;  // unset = as it is
  GroundState state = GroundState::kMeasured;
  double sigma_rad = 0.0;
  double height_sigma = 0.0;  // MapData::ground_height_sigma
  std::string doubt;
};

// In the present world. Errors as AlignMap's.
absl::StatusOr<ChosenGround> ChooseGround(const AlignmentRequest& request,
                                          const WorldSolution& solution,
                                          const MapData& data);

// Present world; zero without views.
Eigen::Vector3d MiddleOfCameras(const MapData& data);

// What of the terrain holds in this map: its height, and how good it is.
struct PlacedTerrain {
  double offset_m = 0.0;  // to be added to its heights
  double sigma_m = 0.0;
  double middle_m = 0.0;  // height below the middle of the cameras, z
};

// Compares it with the map's own ground, of which the report tells. Errors as
// AlignMap's.
absl::StatusOr<PlacedTerrain> PlaceTerrain(const AlignmentRequest& request,
                                           const GivenTerrain& terrain,
                                           const MapData& data,
                                           AlignmentReport& report);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CHOSEN_GROUND_H_
