// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BROWN_LENS_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BROWN_LENS_H_

#include <Eigen/Core>
#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::formats::internal {

// Brown's lens with three radial coefficients k and the tangential p1, p2 (in
// OpenCV's order and sense), with fx = fy = f or not: SIMPLE_PINHOLE to OPENCV
// where that is exact; with k3, the nearest of ours, which is said in
// `warnings` if it is more than 0.05 px off.
//   where  names the camera in messages.
struct BrownLens {
  double fx_px = 0.0;
  double fy_px = 0.0;
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Zero();  // ours
  std::array<double, 3> k{};
  std::array<double, 2> p{};
};
absl::StatusOr<geometry::CameraModel> CameraFromBrown(
    const BrownLens& lens,
    int width_px,
    int height_px,
    std::string_view where,
    std::vector<std::string>* warnings);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BROWN_LENS_H_
