// SPDX-License-Identifier: Apache-2.0
#include "map_store/terrain/elevation_grid.h"

#include <algorithm>
#include <cmath>

namespace groundlock::terrain {

using geometry::GeodeticPosition;

void GeodeticWindow::Include(const GeodeticPosition& place) {
  west_deg = std::min(west_deg, place.longitude_deg);
  east_deg = std::max(east_deg, place.longitude_deg);
  south_deg = std::min(south_deg, place.latitude_deg);
  north_deg = std::max(north_deg, place.latitude_deg);
}

std::optional<double> ElevationGrid::HeightAt(double latitude_deg,
                                              double longitude_deg) const {
  if (columns < 2 || rows() < 2) return std::nullopt;
  const double x = (longitude_deg - window.west_deg) /
                       (window.east_deg - window.west_deg) *
                       static_cast<double>(columns) -
                   0.5;
  const double y = (window.north_deg - latitude_deg) /
                       (window.north_deg - window.south_deg) *
                       static_cast<double>(rows()) -
                   0.5;
  // The outermost middles belong to it, however degrees are rounded. Also false
  // where a number is none.
  constexpr double kRounding = 1e-6;
  if (!(x >= -kRounding && x <= static_cast<double>(columns - 1) + kRounding &&
        y >= -kRounding && y <= static_cast<double>(rows() - 1) + kRounding)) {
    return std::nullopt;
  }
  const auto column =
      std::min(static_cast<std::size_t>(std::max(x, 0.0)), columns - 2);
  const auto row =
      std::min(static_cast<std::size_t>(std::max(y, 0.0)), rows() - 2);
  const double u = x - static_cast<double>(column);
  const double v = y - static_cast<double>(row);
  const float* upper = &heights_m[row * columns + column];
  const float* lower = upper + columns;
  const double height_m = (1.0 - v) * ((1.0 - u) * upper[0] + u * upper[1]) +
                          v * ((1.0 - u) * lower[0] + u * lower[1]);
  if (!std::isfinite(height_m)) return std::nullopt;
  return height_m;
}

WorldTerrain SampleInWorld(const ElevationGrid& grid,
                           const GeodeticPosition& origin,
                           const Eigen::Vector2d& first_m,
                           double step_m,
                           std::size_t columns,
                           std::size_t rows) {
  WorldTerrain terrain;
  terrain.first_m = first_m;
  terrain.step_m = step_m;
  terrain.columns = columns;
  terrain.z_m.reserve(columns * rows);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      Eigen::Vector3d p_world(
          first_m.x() + step_m * static_cast<double>(column),
          first_m.y() + step_m * static_cast<double>(row),
          0.0);
      // The vertical of the world and that of the place differ by the angle
      // between them at the Earth's centre, so that a place moves a little with
      // its height: by 1.6 mm over 10 m, 1 km away. Twice is exact.
      float z_m = std::numeric_limits<float>::quiet_NaN();
      for (int i = 0; i < 2; ++i) {
        const GeodeticPosition place =
            geometry::GeodeticFromWorld(origin, p_world);
        const auto height_m =
            grid.HeightAt(place.latitude_deg, place.longitude_deg);
        if (!height_m) {
          z_m = std::numeric_limits<float>::quiet_NaN();
          break;
        }
        p_world.z() =
            geometry::WorldFromGeodetic(
                origin, {place.latitude_deg, place.longitude_deg, *height_m})
                .z();
        z_m = static_cast<float>(p_world.z());
      }
      terrain.z_m.push_back(z_m);
    }
  }
  return terrain;
}

}  // namespace groundlock::terrain
