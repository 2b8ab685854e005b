// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "absl/strings/str_format.h"
#include "client/simulator/internal/terrain.h"

namespace groundlock::simulator {

ElevationText ElevationModelOf(const Terrain& terrain,
                               double half_side_m,
                               double step_m,
                               const geometry::GeodeticPosition& origin) {
  const int half = static_cast<int>(std::ceil(half_side_m / step_m));
  const int side = 2 * half + 1;
  ElevationText text;
  // Of the lower left cell its corner; values are of the cells' middles.
  const double corner_m = -(half + 0.5) * step_m;
  text.grid = absl::StrFormat(
      "ncols %d\nnrows %d\nxllcorner %.6f\nyllcorner %.6f\ncellsize %.6f\n",
      side,
      side,
      corner_m,
      corner_m,
      step_m);
  for (int row = half; row >= -half; --row) {
    for (int column = -half; column <= half; ++column) {
      absl::StrAppendFormat(
          &text.grid,
          "%s%.4f",
          column == -half ? "" : " ",
          origin.height_m + terrain.HeightAt(column * step_m, row * step_m));
    }
    text.grid += '\n';
  }
  text.coordinate_system = absl::StrFormat(
      "PROJCS[\"about the world's origin\",GEOGCS[\"GCS_WGS_1984\","
      "DATUM[\"D_WGS_1984\",SPHEROID[\"WGS_1984\",6378137.0,298.257223563]],"
      "PRIMEM[\"Greenwich\",0.0],UNIT[\"Degree\",0.0174532925199433]],"
      "PROJECTION[\"Transverse_Mercator\"],PARAMETER[\"False_Easting\",0.0],"
      "PARAMETER[\"False_Northing\",0.0],"
      "PARAMETER[\"Central_Meridian\",%.12f],PARAMETER[\"Scale_Factor\",1.0],"
      "PARAMETER[\"Latitude_Of_Origin\",%.12f],UNIT[\"Meter\",1.0]]\n",
      origin.longitude_deg,
      origin.latitude_deg);
  return text;
}

}  // namespace groundlock::simulator
