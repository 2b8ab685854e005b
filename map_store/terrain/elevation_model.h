// SPDX-License-Identifier: Apache-2.0
// Digital elevation models (GeoTIFF, DTED, whatever GDAL reads), with the datum
// of their heights made explicit: taken for another one, they are wrong by tens
// of metres.
#ifndef GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_MODEL_H_
#define GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_MODEL_H_

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "map_store/terrain/elevation_grid.h"

namespace groundlock::terrain {

// What heights are counted from.
struct VerticalDatum {
  enum class Kind {
    kEllipsoid,  // WGS84's, as a satellite receiver counts
    kEgm96,      // the geoid of 1996: SRTM, DTED
    kEgm2008,    // the geoid of 2008: the Copernicus model
    kGeoidFile,  // any other, by a grid of its heights over the ellipsoid
  };
  Kind kind = Kind::kEllipsoid;
  std::filesystem::path geoid_file;
};

// "ellipsoid", "egm96", "egm2008", or the path of a grid. kInvalidArgument
// lists them.
absl::StatusOr<VerticalDatum> ParseVerticalDatum(std::string_view text);
std::string NameOf(const VerticalDatum& datum);

// What a file says of itself.
struct ElevationModelInfo {
  std::size_t columns = 0, rows = 0;
  // Of a cell at the middle, metres; both positive.
  double cell_m = 0.0;
  GeodeticWindow window;
  std::optional<VerticalDatum> datum;
  // A datum that it names and nobody here knows; empty: none.
  std::string foreign_datum;
};

// From what `gdalinfo -json` prints. kInvalidArgument: no JSON, no coordinate
// system, no place on Earth, heights that are not metres; kDataLoss: absurd
// sizes.
absl::StatusOr<ElevationModelInfo> ParseElevationModelInfo(
    std::string_view json);

// kFailedPrecondition if GDAL's programs are not installed; kInvalidArgument
// names the file, and quotes GDAL, if it is none that GDAL reads.
absl::StatusOr<ElevationModelInfo> ReadElevationModelInfo(
    const std::filesystem::path& file);

struct ElevationModelRequest {
  std::filesystem::path file;
  // nullopt: what the file says. kFailedPrecondition if it does not, and
  // kInvalidArgument if it says something else.
  std::optional<VerticalDatum> datum;
  GeodeticWindow window;
  // Of the result, each 2 to kMaxSide.
  std::size_t columns = 0, rows = 0;
  std::function<bool()> is_cancelled;
};
inline constexpr std::size_t kMaxSide = 4'000;

// The model over the window, resampled (bilinearly), over the ellipsoid. GDAL's
// gdalinfo and gdalwarp do it in a cage (cage/child_process.h): whatever a file
// makes them do, it is one failed request. Nothing is fetched from a network:
// where the geoid's grid is not installed, kFailedPrecondition says what is
// missing. kNotFound: no such file; kOutOfRange: the model knows nothing of the
// window.
absl::StatusOr<ElevationGrid> ReadElevationModel(
    const ElevationModelRequest& request);

}  // namespace groundlock::terrain

#endif  // GROUNDLOCK_MAP_STORE_TERRAIN_ELEVATION_MODEL_H_
