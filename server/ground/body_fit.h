// SPDX-License-Identifier: Apache-2.0
// A body at rest from points of its surface: the box whose faces they lie on.
// Lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"

namespace groundlock::ground {

// A point that is seen on, or close by, a body, triangulated from several
// views.
struct BodyPoint {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Identity();
};

// From where a silhouette of it was seen.
struct OutlineView {
  geometry::CameraModel camera;
  geometry::Rigid3 world_from_camera;
  SeenOutline outline;
};

struct BodyPoints {
  std::vector<BodyPoint> points;
  // Where the cameras were that saw them, about evenly along their way.
  std::vector<Eigen::Vector3d> eyes_world;
  std::vector<OutlineView> outlines = {};  // further ones than the drawn box
};

// Vehicles are 1.7 to 3 times as long as wide, crates and people's footprints
// once; most things on the ground are about as tall as their footprint.
inline constexpr ShapePrior kShapeOfAnyBody{.length_over_width = 1.6,
                                            .length_over_width_sigma = 0.5,
                                            .tallness = 0.7,
                                            .tallness_sigma = 0.8};

// What is known of a body before its points are looked at.
struct BodyKnowledge {
  // The guess is a fit to earlier points of the same body, which another way of
  // standing must be 20 times likelier than.
  bool is_fit = false;
  // Of the guess's heading, along its length; nullopt: it may stand in any way.
  std::optional<double> heading_sigma_rad = std::nullopt;
  // Of the logarithm of a common scale of all points about the camera: of a
  // body that moves they leave it open (SolveBodyMotion), and that the body
  // stands on the ground tells it; 0: the points have a scale.
  double scale_sigma = 0.0;
  // Of that ground's height; 0: it is known.
  double ground_sigma_m = 0.0;
  SizePrior size = SizePriorOf(kShapeOfAnyBody);
};

struct BodyFit {
  // As the points have it; the longer side along x, or the heading if that was
  // known.
  geometry::Box3 box;
  BodyShape shape;
  // By which it is larger, and farther from the camera.
  double scale = 1.0;
  // Of the direction of its sides.
  double axis_sigma_rad = 0.0;
  // Of the logarithms of length, width and height, the scale's part included.
  Eigen::Matrix3d log_size_covariance = Eigen::Matrix3d::Zero();
  // Squared Mahalanobis distance of extents and heading from what was known
  // before: chi-square of 4 degrees, of 3 if the heading was not.
  double surprise = 0.0;
};

// The upright box whose faces most points lie on and whose projected body is
// nearest to the box that was drawn about it, and to its silhouettes: maximum a
// posteriori over place, direction and extents. A point may also lie inside
// (windows behind a bonnet, what is seen through) or be none of the body's: a
// mixture, fitted by expectation and maximisation with Gauss-Newton steps, from
// starts in all directions. What projects outside the drawn box, lies on the
// ground, or far from `guess` is left out.
//   drawn     the view in which drawn_px was drawn, with the ground's tangent.
//   guess     where, and how large, the body is taken to be.
// nullopt: too few points, or they leave open which way it stands (another
// direction is as likely as 5 %, or it is known to no better than 5 degrees).
// Thread-safe. 3 ms with 120 points, 10 with 400, without silhouettes.
// Sources: Zhang, Xu, Dong, Dolan 2017, "Efficient L-shape fitting for vehicle
// detection using laser scanners" (search over directions); the mixture is
// that of MLESAC (Torr & Zisserman 2000, §3).
std::optional<BodyFit> FitBodyToPoints(const GroundView& drawn,
                                       const geometry::Box2& drawn_px,
                                       const geometry::Box3& guess,
                                       const BodyKnowledge& known,
                                       const BodyPoints& seen);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_FIT_H_
