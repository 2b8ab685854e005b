// SPDX-License-Identifier: Apache-2.0
// The ground of a map on Earth, from an elevation model.
#ifndef GROUNDLOCK_CLIENT_CLI_MAP_TERRAIN_H_
#define GROUNDLOCK_CLIENT_CLI_MAP_TERRAIN_H_

#include <functional>
#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/map_types.h"

namespace groundlock::cli {

struct TerrainFlags {
  std::string file;
  std::string datum;      // empty: what the file says
  double sigma_m = 0.0;   // 0 = as the map's ground scatters about it
  double margin_m = 0.0;  // beyond the map; 0 = half of its extent
  bool fit = false;
};

// What of the model the map and its surroundings need, in the map's world.
//   cloud  a sample of the map's points, and its cameras
// kFailedPrecondition: the map has no place on Earth; else as
// terrain::ReadElevationModel.
absl::StatusOr<sdk::AlignRequest::Terrain> ReadTerrain(
    const TerrainFlags& flags,
    const sdk::MapInfo& map,
    const sdk::PointCloud& cloud,
    const std::function<bool()>& is_cancelled);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_MAP_TERRAIN_H_
