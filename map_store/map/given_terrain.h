// SPDX-License-Identifier: Apache-2.0
// Ground whose heights somebody else measured: an elevation model.
#ifndef GROUNDLOCK_MAP_STORE_MAP_GIVEN_TERRAIN_H_
#define GROUNDLOCK_MAP_STORE_MAP_GIVEN_TERRAIN_H_

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "map_store/map/ground_relief.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {

// Heights on a regular grid over x and y of a world whose z is up. Lengths in
// metres (map units if the map is not metric).
struct GivenTerrain {
  Eigen::Vector2d first = Eigen::Vector2d::Zero();  // of column 0, row 0
  double step = 1.0;
  std::size_t columns = 0;
  // z, row by row along y, each along x; NaN where nobody knows.
  std::vector<float> z;
  // 1 sigma of a height; 0 = as the map's own ground scatters about it.
  double sigma = 0.0;
  // Move it up or down to the ground that the map's landmarks show. A camera's
  // height by GPS is wrong by metres, a terrain's shape is not.
  bool fit_height = false;

  std::size_t rows() const { return columns == 0 ? 0 : z.size() / columns; }
  // kInvalidArgument.
  absl::Status Validate() const;
};

// A spline through the terrain's heights over the level plane z = `height`.
GroundRelief ReliefOf(const GivenTerrain& terrain, double height, double sigma);

// How the landmarks of a map lie to a terrain.
struct TerrainAgreement {
  // Of the most that lie at one height: those of the ground.
  double offset = 0.0;   // the map's ground over the terrain
  double scatter = 0.0;  // 1 sigma about it
  std::size_t num_ground = 0;
  std::size_t num_landmarks = 0;  // over the known terrain
};
// nullopt: too few landmarks lie at one height to tell. `data` in a world.
std::optional<TerrainAgreement> CompareWithLandmarks(
    const GivenTerrain& terrain, const MapData& data);

// Share of the cameras over the known terrain that lie below it, were it
// `offset` higher; NaN if there are none.
double ShareBelow(const GivenTerrain& terrain,
                  double offset,
                  const MapData& data);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_GIVEN_TERRAIN_H_
