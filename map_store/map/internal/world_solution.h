// SPDX-License-Identifier: Apache-2.0
// Where a map's new world lies, by what an alignment was given.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_WORLD_SOLUTION_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_WORLD_SOLUTION_H_

#include <optional>

#include "absl/status/statusor.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/alignment.h"

namespace groundlock::map::internal {

// The new world, and whether its place is fixed by what was given.
struct WorldSolution {
  geometry::Similarity3 new_world_from_world;
  std::optional<geometry::GeodeticPosition> origin;
  bool metric = true;
  bool fixed = true;         // the ground may not move it
  bool origin_free = false;  // its height is ours to choose
};

// By the request's method; its ground is not looked at. Residuals and warnings
// go into the report. Errors as AlignMap's.
absl::StatusOr<WorldSolution> SolveWorld(const AlignmentRequest& request,
                                         const MapData& data,
                                         AlignmentReport& report);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_WORLD_SOLUTION_H_
