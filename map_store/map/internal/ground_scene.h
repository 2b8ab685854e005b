// SPDX-License-Identifier: Apache-2.0
// What the search for the ground looks at.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SCENE_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SCENE_H_

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::map::internal {

struct GroundScene {
  // Landmarks in random order, one per cell of a grid, so that a richly
  // textured wall counts by its area and not by its features.
  std::vector<Eigen::Vector3d> points;
  // How far each may lie from a plane that it belongs to: a share of its mean
  // distance to the cameras that see it, as triangulation errors are.
  std::vector<double> tolerances;
  std::vector<Eigen::Vector3d> centers;
  std::vector<geometry::Rigid3> camera_from_world;
};

// Indices of the points whose distance to the plane is below num_tolerances
// times their tolerance.
std::vector<std::size_t> PointsWithin(const GroundScene& scene,
                                      const geometry::Plane& plane,
                                      double num_tolerances);

std::vector<Eigen::Vector3d> Select(const GroundScene& scene,
                                    const std::vector<std::size_t>& indices);

// The plane with its normal towards the cameras, if nearly all are on one side.
std::optional<geometry::Plane> TowardsCameras(const GroundScene& scene,
                                              geometry::Plane plane);

// `data` must be valid.
GroundScene MakeGroundScene(const MapData& data, std::uint64_t seed);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SCENE_H_
