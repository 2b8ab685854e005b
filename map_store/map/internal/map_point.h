// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAP_POINT_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAP_POINT_H_

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/map/alignment.h"

namespace groundlock::map::internal {

// The view of that name or, if there is none, of that file name whatever folder
// either has before it; kInvalidArgument if there is none, or several.
absl::StatusOr<std::size_t> FindView(const MapData& data,
                                     std::string_view name);

// Where the point is: as given, or triangulated (the rays' nearest point,
// refined to the least reprojection error). kInvalidArgument without a
// position or two pixels, or outside of an image; kFailedPrecondition if the
// rays are too near to parallel or do not meet. `name` is for messages.
absl::StatusOr<Eigen::Vector3d> LocateMapPoint(
    const MapData& data,
    const MapPoint& point,
    std::string_view name,
    std::vector<std::string>& warnings);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAP_POINT_H_
