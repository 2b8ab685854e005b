// SPDX-License-Identifier: Apache-2.0
// Where cameras were measured to be, against where the map has them.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CAMERA_POSITION_FIT_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CAMERA_POSITION_FIT_H_

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::map::internal {

struct CameraPositionFit {
  geometry::Similarity3 measured_from_world;
  std::vector<bool> used;  // per camera
  std::vector<std::string> warnings;
};

// The similarity that at least half of the positions agree on to `accuracy_m`
// (1 sigma per axis). If there is none, positions are worse than was thought:
// their heights are left out, z of the world then being up, and they are given
// up to kMaxLoosening times the accuracy, as long as the cameras spread by more
// than that; warnings say so, with figures. kFailedPrecondition: even so less
// than half agree.
//   p_world     cameras' centres in the map's world, at least 3
//   p_measured  likewise, metres, z up
inline constexpr double kMaxLoosening = 10.0;
absl::StatusOr<CameraPositionFit> FitCameraPositions(
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector3d> p_measured,
    double accuracy_m,
    std::uint64_t seed);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_CAMERA_POSITION_FIT_H_
