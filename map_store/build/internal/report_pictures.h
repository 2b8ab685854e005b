// SPDX-License-Identifier: Apache-2.0
// The report's pictures, drawn in the plane z = 0 of an aligned map.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_

#include <filesystem>

#include "absl/status/status.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// Landmarks from above in their colours; cameras as wedges along their way.
absl::Status WriteMapPicture(const map::MapData& aligned,
                             const std::filesystem::path& path);
// Per cell of a grid, by how many images its landmarks were seen.
absl::Status WriteCoveragePicture(const map::MapData& aligned,
                                  const std::filesystem::path& path);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_
