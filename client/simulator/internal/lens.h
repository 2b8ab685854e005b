// SPDX-License-Identifier: Apache-2.0
// The rendered camera's lens. Written apart from map_store/geometry on purpose:
// the truth must not share the code that it is a truth for.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LENS_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LENS_H_

#include <Eigen/Core>
#include <optional>
#include <string>

namespace groundlock::simulator {

// SIMPLE_RADIAL: x_d = (1 + k |x|^2) x, pixel = f x_d + c (Robinson 2014,
// §3.2). The first pixel's centre is (0.5, 0.5).
struct Lens {
  int width_px = 0;
  int height_px = 0;
  double f = 0.0;
  double cx = 0.0;
  double cy = 0.0;
  double k = 0.0;

  // f = 1050 px at a width of 1280 px, k = -0.045.
  static Lens ForSize(int width_px, int height_px);
  // Undistorted coordinates on z = 1 of a pixel.
  Eigen::Vector2d Undistort(double x_px, double y_px) const;
  // nullopt behind the camera or where the polynomial folds back.
  std::optional<Eigen::Vector2d> Project(const Eigen::Vector3d& p_camera) const;
  bool Contains(const Eigen::Vector2d& p_px) const;
  // The content of camera.json.
  std::string ToJson() const;
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LENS_H_
