// SPDX-License-Identifier: Apache-2.0
// Which lens frames are taken with when the client names none.
#ifndef GROUNDLOCK_SERVER_SERVICE_SESSION_LENS_H_
#define GROUNDLOCK_SERVER_SERVICE_SESSION_LENS_H_

#include <opencv2/core/types.hpp>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/map/map.h"

namespace groundlock::service {

// kInvalidArgument if the map's views have several lenses.
absl::StatusOr<geometry::CameraModel> LensOfMap(const map::Map& map,
                                                const std::string& name);

// The lens of a frame of that size: `lens`, scaled if need be, or, without one
// (a session without a map, which measures nothing), any of the size.
// kInvalidArgument if the lens is of another picture.
absl::StatusOr<geometry::CameraModel> LensForSize(
    const std::optional<geometry::CameraModel>& lens, const cv::Size& size_px);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SESSION_LENS_H_
