// SPDX-License-Identifier: Apache-2.0
#include "map_store/terrain/elevation_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace groundlock::terrain {
namespace {

using geometry::GeodeticPosition;

constexpr GeodeticPosition kOrigin{58.4, 15.6, 40.0};

// Heights that grow by `east_m` with each column and by `north_m` with each row
// northwards.
ElevationGrid Slope(std::size_t columns,
                    std::size_t rows,
                    double east_m,
                    double north_m) {
  ElevationGrid grid;
  grid.window = {15.59, 58.39, 15.61, 58.41};
  grid.columns = columns;
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      grid.heights_m.push_back(
          static_cast<float>(100.0 + east_m * static_cast<double>(column) +
                             north_m * static_cast<double>(rows - 1 - row)));
    }
  }
  return grid;
}

TEST(ElevationGridTest, IsBilinearBetweenTheMiddlesOfCells) {
  const ElevationGrid grid = Slope(20, 10, 1.0, 2.0);
  const double cell_deg = 0.02 / 20;
  const double west = 15.59 + 0.5 * cell_deg;
  const double north = 58.41 - 0.5 * 0.002;
  EXPECT_NEAR(*grid.HeightAt(north, west), 118.0, 1e-5);
  EXPECT_NEAR(*grid.HeightAt(north, west + 3.25 * cell_deg), 121.25, 1e-5);
  EXPECT_NEAR(*grid.HeightAt(north - 0.001, west), 117.0, 1e-5);
  // Beyond the outermost middles nothing is known, nor is it for no number.
  EXPECT_FALSE(grid.HeightAt(north, west - 0.1 * cell_deg));
  EXPECT_FALSE(grid.HeightAt(58.41, west));
  EXPECT_FALSE(grid.HeightAt(std::nan(""), west));
  EXPECT_FALSE(ElevationGrid().HeightAt(58.4, 15.6));
}

TEST(ElevationGridTest, KnowsNothingBesideAHole) {
  ElevationGrid grid = Slope(20, 10, 1.0, 0.0);
  grid.heights_m[5 * 20 + 7] = std::numeric_limits<float>::quiet_NaN();
  const auto at = [&](double column, double row) {
    return grid.HeightAt(58.41 - (row + 0.5) * 0.002,
                         15.59 + (column + 0.5) * 0.001);
  };
  EXPECT_FALSE(at(7.0, 5.0));
  EXPECT_FALSE(at(6.5, 4.5));
  EXPECT_TRUE(at(8.5, 5.0));
  EXPECT_TRUE(at(6.5, 3.5));
}

TEST(ElevationGridTest, TheEarthIsRoundInTheWorld) {
  const ElevationGrid grid = Slope(4, 4, 0.0, 0.0);  // 100 m everywhere
  const WorldTerrain terrain =
      SampleInWorld(grid, kOrigin, {-300.0, -300.0}, 100.0, 7, 7);
  ASSERT_EQ(terrain.z_m.size(), 49U);
  // Above the origin as high as it is over the ellipsoid.
  EXPECT_NEAR(terrain.z_m[3 * 7 + 3], 60.0, 1e-4);
  // 424 m from there the ellipsoid has fallen away by d^2 / 2R = 14 mm.
  EXPECT_NEAR(terrain.z_m[0], 60.0 - 0.0141, 2e-4);
  const GeodeticPosition corner =
      geometry::GeodeticFromWorld(kOrigin, {-300.0, -300.0, terrain.z_m[0]});
  EXPECT_NEAR(corner.height_m, 100.0, 1e-4);
}

TEST(ElevationGridTest, RowsOfTheWorldRunNorth) {
  const ElevationGrid grid = Slope(200, 100, 1.0, 2.0);
  const WorldTerrain terrain =
      SampleInWorld(grid, kOrigin, {-20.0, -20.0}, 10.0, 5, 5);
  EXPECT_GT(terrain.z_m[4], terrain.z_m[0]);      // eastwards
  EXPECT_GT(terrain.z_m[4 * 5], terrain.z_m[0]);  // northwards
  // Outside of what is known: a hole, not a guess.
  const WorldTerrain outside =
      SampleInWorld(grid, kOrigin, {5'000.0, 0.0}, 10.0, 3, 3);
  for (const float z_m : outside.z_m) EXPECT_TRUE(std::isnan(z_m));
}

}  // namespace
}  // namespace groundlock::terrain
