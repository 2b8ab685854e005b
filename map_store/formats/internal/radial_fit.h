// SPDX-License-Identifier: Apache-2.0
// Distortions that our camera models do not have, by the nearest that they do.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_RADIAL_FIT_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_RADIAL_FIT_H_

#include <Eigen/Core>
#include <functional>
#include <utility>

#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::formats::internal {

// A camera model of ours for a foreign one, and how far the two are apart.
struct FittedCamera {
  geometry::CameraModel camera;
  double max_residual_px = 0.0;  // up to radius_px
  double radius_px = 0.0;  // of the circle within which the two were compared
};

// The first of SIMPLE_RADIAL, RADIAL and OPENCV_FISHEYE, with the given focal
// length and coefficients fitted by least squares, that stays below 0.05 px
// within radius_px of the principal point, else the best.
//   pair_at  for radii r in (0, radius_px / focal_px] of its own choice: where
//            a point is undistorted, and where it is measured, both as radii on
//            z = 1.
// kInvalidArgument if no model fits.
absl::StatusOr<FittedCamera> FitRadialCamera(
    double focal_px,
    int width_px,
    int height_px,
    const Eigen::Vector2d& principal_point_px,
    double radius_px,
    const std::function<std::pair<double, double>(double)>& pair_at);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_RADIAL_FIT_H_
