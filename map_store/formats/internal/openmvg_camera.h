// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_CAMERA_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_CAMERA_H_

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::formats::internal {

// A camera of ours for an intrinsic of sfm_data.json.
//   type  cereal's name of it, "pinhole_radial_k3"; if it is empty, the fields
//         of `data` tell.
// kUnimplemented names a type that is not supported.
absl::StatusOr<geometry::CameraModel> ReadOpenMvgCamera(
    std::string_view type,
    const JsonNode& data,
    std::vector<std::string>* warnings);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_CAMERA_H_
