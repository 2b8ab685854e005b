// SPDX-License-Identifier: Apache-2.0
// What gdalinfo says of a stranger's file: a size and a place that make sense,
// or an error.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/terrain/elevation_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const auto info = groundlock::terrain::ParseElevationModelInfo(
      {reinterpret_cast<const char*>(data), size});
  if (!info.ok()) return 0;
  if (info->columns == 0 || info->rows == 0 || !(info->cell_m > 0.0) ||
      !(info->window.east_deg > info->window.west_deg) ||
      !(info->window.north_deg <= 90.0)) {
    __builtin_trap();
  }
  return 0;
}
