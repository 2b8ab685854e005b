// SPDX-License-Identifier: Apache-2.0
// Where the ground of a map is.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/map_data.h"

namespace groundlock::map::internal {

// The ground below the cameras, as AlignToEstimatedGround finds it, in the
// coordinates of `data`; its normal points up.
//   up  if known: grounds that slope by more than some 20 degrees lose. Unset,
//       the data's measured_up counts.
absl::StatusOr<GroundEstimate> EstimateGround(
    const MapData& data,
    std::uint64_t seed,
    const std::optional<Eigen::Vector3d>& up);

// The plane of the landmarks around `seed_point`, its normal towards the
// cameras (Robinson 2014, section 3.6.1). kFailedPrecondition if the landmarks
// there make no plane.
absl::StatusOr<geometry::Plane> FitGroundAround(
    const MapData& data, const Eigen::Vector3d& seed_point, std::uint64_t seed);

// Keeps the scale: the ground becomes z = 0 below the middle of the cameras,
// which is above it; x is the first camera's right.
geometry::Similarity3 LevelledFromSource(const MapData& data,
                                         const geometry::Plane& ground);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_H_
