// SPDX-License-Identifier: Apache-2.0
// Heights of the ground on Earth, over the ellipsoid.
#ifndef GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_GRID_H_
#define GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_GRID_H_

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

#include "map_store/geometry/geodesy.h"

namespace groundlock::terrain {

// A part of the Earth between two meridians and two parallels, WGS84, degrees.
// Not across the 180th meridian.
struct GeodeticWindow {
  double west_deg = std::numeric_limits<double>::infinity();
  double south_deg = std::numeric_limits<double>::infinity();
  double east_deg = -std::numeric_limits<double>::infinity();
  double north_deg = -std::numeric_limits<double>::infinity();

  void Include(const geometry::GeodeticPosition& place);
};

// A regular grid over a window: its cells' middles lie half a cell inside.
// Const methods are thread-safe.
struct ElevationGrid {
  GeodeticWindow window;
  std::size_t columns = 0;
  // Over the WGS84 ellipsoid, metres, row by row from the north, each from the
  // west; NaN where nobody knows.
  std::vector<float> heights_m;

  std::size_t rows() const {
    return columns == 0 ? 0 : heights_m.size() / columns;
  }
  // Bilinear; nullopt outside of the middles, and beside a place that nobody
  // knows.
  std::optional<double> HeightAt(double latitude_deg,
                                 double longitude_deg) const;
};

// Heights of the ground in a georeferenced world (x east, y north, z up), on a
// regular grid over x and y.
struct WorldTerrain {
  Eigen::Vector2d first_m = Eigen::Vector2d::Zero();  // of column 0, row 0
  double step_m = 1.0;
  std::size_t columns = 0;
  // z, row by row northwards, each eastwards; NaN where nobody knows.
  std::vector<float> z_m;
};

// The same ground at `rows` x `columns` places of the world at `origin`. Exact
// for the grid: the Earth's curvature is part of it.
WorldTerrain SampleInWorld(const ElevationGrid& grid,
                           const geometry::GeodeticPosition& origin,
                           const Eigen::Vector2d& first_m,
                           double step_m,
                           std::size_t columns,
                           std::size_t rows);

}  // namespace groundlock::terrain

#endif  // GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_GRID_H_
