// SPDX-License-Identifier: Apache-2.0
// Points from the rays of several cameras.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRIANGULATION_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRIANGULATION_H_

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::build::internal {

struct Sight {
  const geometry::CameraModel* camera = nullptr;
  geometry::Rigid3 camera_from_world;
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
};

struct TriangulationOptions {
  double max_error_px = 3.0;
  double min_angle_rad = 0.026;  // 1.5 degrees, as COLMAP's
  int min_sights = 2;
};

struct Triangulated {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  std::vector<bool> is_inlier;  // per sight
  double mean_error_px = 0.0;   // of the inliers
  double angle_rad = 0.0;       // the widest between two inliers' rays
};

// The point that most sights agree on: every pair of sights (of a track of up
// to 12, else a spread subset) proposes one, the largest set of those within
// max_error_px wins and is refined by Gauss-Newton. nullopt if no point has
// min_sights inliers, lies before all of them, and opens min_angle_rad.
// Source: Hartley & Zisserman, 2nd ed., section 12.2 and A6.
std::optional<Triangulated> Triangulate(std::span<const Sight> sights,
                                        const TriangulationOptions& options);

// Distance of `pixel2` of camera 2 to the epipolar line of a ray of camera 1,
// px; infinite where the line has no direction. The line is taken at the
// normalised pixel and scaled by camera 2's focal length: exact without
// distortion, good to its local stretch with it.
//   ray1, ray2  normalised image points (z = 1)
double EpipolarDistance_px(const geometry::Rigid3& camera2_from_camera1,
                           const Eigen::Vector3d& ray1,
                           const Eigen::Vector3d& ray2,
                           double focal2_px);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRIANGULATION_H_
