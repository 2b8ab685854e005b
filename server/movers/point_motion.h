// SPDX-License-Identifier: Apache-2.0
// Does a point of the image rest in the world, or does it go over the ground?
// Pure and thread-safe; lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_MOVERS_POINT_MOTION_H_
#define GROUNDLOCK_SERVER_MOVERS_POINT_MOTION_H_

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::movers {

// A camera at one time.
struct KeyView {
  double time_s = 0.0;
  geometry::Rigid3 world_from_camera;
  // Of this pose against those of the other views, as rigid3.h says.
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
};

// Where the point was seen: undistorted coordinates on z = 1.
struct Sighting {
  std::size_t view = 0;  // index into the views
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();
};

// The ground under the point.
struct LocalGround {
  geometry::Plane plane_world;  // normal up, the cameras above it
  double height_sigma_m = 0.0;
};

struct PointNoise {
  double sigma = 0.0;  // of a sighting's coordinates, on z = 1
};

// How well a place at rest, on the ground or above it, explains sightings.
struct RestFit {
  double chi2 = 0.0;
  int degrees = 0;  // of freedom; 0: too few sightings
  // In the newest view: over the depth; 0 = infinitely far.
  double inverse_depth = 0.0;
};

// A maximum-likelihood place by Gauss-Newton, kept from going under the ground
// by the ground's own uncertainty.
//   sightings  oldest first; at least two. The last one's view is the newest.
RestFit FitRest(std::span<const Sighting> sightings,
                std::span<const KeyView> views,
                const LocalGround& ground,
                const PointNoise& noise);

// How well motion over the ground does, and which: weighted least squares of a
// constant acceleration in the ground's plane, which is likely to change the
// speed by `change_per_s` of it (1 sigma). A point above the ground is taken to
// be on it.
struct GroundMotion {
  double chi2 = 0.0;
  int degrees = 0;  // 0: too few sightings, or a ray that misses the ground
  // In the newest view, in geometry::PlaneAxes of the ground's plane.
  Eigen::Vector2d place_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Zero();  // place, velocity
};
GroundMotion FitGroundMotion(std::span<const Sighting> sightings,
                             std::span<const KeyView> views,
                             const LocalGround& ground,
                             const PointNoise& noise,
                             double change_per_s);

// The chi-square that is exceeded as seldom as a normal variable exceeds z
// standard deviations (one-sided).
// Source: Wilson & Hilferty 1931.
double ChiSquareAt(int degrees, double z);

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_POINT_MOTION_H_
