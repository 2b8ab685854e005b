// SPDX-License-Identifier: Apache-2.0
// A body at rest from points of its surface: the box whose faces they lie on.
// Lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/ground/ground_model.h"

namespace groundlock::ground {

// A point that is seen on, or close by, a body, triangulated from several
// views.
struct BodyPoint {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Identity();
};

struct BodyPoints {
  std::vector<BodyPoint> points;
  // Where the cameras were that saw them, about evenly along their way.
  std::vector<Eigen::Vector3d> eyes_world;
};

struct BodyFit {
  geometry::Box3 box;  // the longer side along x
  // Of the direction of its sides.
  double axis_sigma_rad = 0.0;
};

// The upright box whose faces most points lie on and whose projected body is
// nearest to the box that was drawn about it: maximum a posteriori over place,
// direction and extents. A point may also lie inside (windows behind a
// bonnet, what is seen through) or be none of the body's: a mixture, fitted by
// expectation and maximisation with Gauss-Newton steps, from starts in all
// directions. What projects outside the drawn box, lies on the ground, or far
// from `guess` is left out.
//   drawn     the view in which drawn_px was drawn, with the ground's tangent.
//   guess     where, and how large, the body is taken to be.
//   is_fit    it is a fit to earlier points of the same body, which another way
//             of standing must be 20 times likelier than.
// nullopt: too few points, or they leave open which way it stands (another
// direction is as likely as 5 %, or it is known to no better than 5 degrees).
// Thread-safe. 3 ms with 120 points, 10 with 400.
// Sources: Zhang, Xu, Dong, Dolan 2017, "Efficient L-shape fitting for vehicle
// detection using laser scanners" (search over directions); the mixture is
// that of MLESAC (Torr & Zisserman 2000, §3).
std::optional<BodyFit> FitBodyToPoints(const GroundView& drawn,
                                       const geometry::Box2& drawn_px,
                                       const geometry::Box3& guess,
                                       bool is_fit,
                                       const BodyPoints& seen);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_
