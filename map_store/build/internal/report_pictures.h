// SPDX-License-Identifier: Apache-2.0
// The report's pictures of an aligned map: its ground is the plane z = 0.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_

#include <filesystem>

#include "absl/status/status.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// Landmarks from above in their colours; cameras as wedges along their way.
absl::Status WritePictureFromAbove(const map::MapData& aligned,
                                   const std::filesystem::path& path);
// The same from the side, across the direction in which the map is longest,
// with the ground as a line if there is one: what lies on it, stands on it or
// hangs above it is seen at a glance.
absl::Status WritePictureFromTheSide(const map::MapData& aligned,
                                     bool has_ground,
                                     const std::filesystem::path& path);
// Per cell of a grid, by how many images its landmarks were seen.
absl::Status WriteCoveragePicture(const map::MapData& aligned,
                                  const std::filesystem::path& path);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_REPORT_PICTURES_H_
