// SPDX-License-Identifier: Apache-2.0
// Boxes on the ground that fit boxes in the image, where the thesis' front-face
// construction is rough: it takes the footprint for square (20 cm of bias on a
// 0.9 m car, Robinson 2014, §4.3), takes the 2D box's upper edge for the front
// face's although it is the back's, and breaks down for a target seen from
// above. Pure and thread-safe; lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BOX_FIT_H_
#define GROUNDLOCK_SERVER_GROUND_BOX_FIT_H_

#include <Eigen/Core>
#include <array>
#include <optional>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/convex_polygon.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/ground_model.h"

namespace groundlock::ground {

// How a body fills its upright box. Things narrow towards the top (roofs,
// heads), so that the box's upper corners are empty: seen from 25 degrees
// above, a car of 0.9 x 0.5 x 0.35 m is 165 px tall where its box is 230; and
// they are rounded, so that the corners on the ground are empty too. The body
// is an octagon that touches the box's sides with a share `plan` of their
// lengths, up to half the height, and narrows to a share `roof` of length and
// width at the top. Its ends hang over by `clearance` of the height, while it
// stands on wheels at 60 % of its length.
struct BodyShape {
  double plan = 0.6;
  double roof = 0.6;
  double clearance = 0.0;
};

// The axis-aligned hull of such a body in the image. nullopt if a point of it
// is not in front of the camera.
std::optional<geometry::Box2> ProjectBodyHull(const GroundView& view,
                                              const geometry::Box3& box,
                                              const BodyShape& shape = {});

// The same, and which points of the body make its left, upper, right and lower
// edge, in the object frame of the box.
struct BodyHull {
  geometry::Box2 box_px;
  std::array<Eigen::Vector3d, 4> edges_object;
};
std::optional<BodyHull> ProjectBodyEdges(const GroundView& view,
                                         const geometry::Box3& box,
                                         const BodyShape& shape = {});

// Which part of the image such a body takes. nullopt as above.
std::optional<geometry::ConvexPolygon> ProjectBody(const GroundView& view,
                                                   const geometry::Box3& box,
                                                   const BodyShape& shape = {});

// The outline of a body in the image, as far as it is seen. Each edge lies
// between that of what is surely the body and that of what may be: its shade,
// say. That may go on without end (infinite).
struct SeenOutline {
  geometry::Box2 sure_px;
  geometry::Box2 possible_px;
  double sigma_px = 1.0;  // of an edge
  // The left, upper, right and lower one: are the two so near to each other
  // that they tell where it is?
  std::array<bool, 4> is_seen{true, true, true, true};

  // How far beyond these each edge of an outline is.
  Eigen::Vector4d OffBy_px(const geometry::Box2& outline_px) const;
  // By how much the outline is too wide and too high, wherever it is.
  Eigen::Vector2d SizeOffBy_px(const geometry::Box2& outline_px) const;
};

// What is believed of a target's shape before it is measured: log-normal, so
// sigmas are relative. One 2D box has four numbers and an upright box of known
// heading has five (place, length, width, height): a prior must choose.
struct ShapePrior {
  double length_over_width = 1.0;
  double length_over_width_sigma = 0.3;
  // Height over the side of a square of the footprint's area. Cars 0.5, people
  // 3.5: hence wide.
  double tallness = 0.8;
  double tallness_sigma = 0.8;
};

// The upright box whose projected body is nearest to box_px, given the prior:
// maximum a posteriori by Levenberg-Marquardt over place and extents. An edge
// of box_px is taken to be good to 1 px or 1 % of the box's size.
//   heading_world  direction of the box's length; nullopt: away from the
//     camera along the ground (the thesis' front face), unless no likely shape
//     looks so: then, as from above, whichever way the likeliest one stands.
// Also works for targets seen from above and rolled cameras.
// kInvalidArgument: no size. kOutOfRange: the middle of the box's lower edge is
// not on the ground in front of the camera, or nothing fits.
absl::StatusOr<geometry::Box3> FitBox(
    const GroundView& view,
    const geometry::Box2& box_px,
    const std::optional<Eigen::Vector3d>& heading_world,
    const ShapePrior& prior);

// The direction along the ground from the camera to a place there, or of the
// image's upper edge where that is right below the camera.
Eigen::Vector3d AwayOnGround(const GroundView& view,
                             const Eigen::Vector3d& p_world);

// What is believed of a target's size before it is measured: log-normal.
struct SizePrior {
  Eigen::Vector3d size_m = Eigen::Vector3d::Ones();  // length, width, height
  // What makes the logarithms' differences from those independent, of sigma 1.
  Eigen::Matrix3d whitening_log = Eigen::Matrix3d::Identity();
};

// The same proportions of any size: no density, since all sizes are as likely.
SizePrior SizePriorOf(const ShapePrior& shape);

struct BoxFit {
  geometry::Box3 box;
  // Of the logarithms of length, width and height.
  Eigen::Matrix3d log_size_covariance = Eigen::Matrix3d::Identity();
  // The density of seeing such a box, where bodies stand anywhere on the ground
  // alike, but for a factor that is the same for all of one view's box
  // (Laplace's approximation: MacKay 1992, "Bayesian interpolation").
  double log_evidence = 0.0;
};

// FitBox for a body of about known size, whose length is along heading_world.
// nullopt: nothing fits.
std::optional<BoxFit> FitBoxOfSize(const GroundView& view,
                                   const geometry::Box2& box_px,
                                   const Eigen::Vector3d& heading_world,
                                   const SizePrior& prior);

// Where a box of given heading and size stands if its projected body is centred
// at center_px.
struct PlacedBox {
  geometry::Box3 box;
  // d (place on the ground, in the axes of geometry::PlaneAxes) / d center_px.
  Eigen::Matrix2d place_by_center_m_px = Eigen::Matrix2d::Zero();
};

// Newton's method on the ground from p_guess_world, else from the ground under
// center_px. It needs no scale of the 2D box, so noise in the box's size does
// not move the target. nullopt if it leads nowhere (above the horizon).
std::optional<PlacedBox> PlaceBoxByCenter(const GroundView& view,
                                          const Eigen::Vector2d& center_px,
                                          const Eigen::Vector3d& heading_world,
                                          const Eigen::Vector3d& size_m,
                                          const Eigen::Vector3d& p_guess_world);

// The same for a point that is fixed in the object, given in the object frame
// of the box: closed form, the ray through the pixel meets the plane at the
// point's height. This is what a tracker that learns appearance follows:
// texture, not the outline's centre, which wanders over the body as the view
// changes.
std::optional<PlacedBox> PlaceBoxByPoint(const GroundView& view,
                                         const Eigen::Vector2d& pixel_px,
                                         const Eigen::Vector3d& heading_world,
                                         const Eigen::Vector3d& size_m,
                                         const Eigen::Vector3d& p_object);

// The point of a box's inside, in its object frame, that lies on the ray
// through pixel_px: `depth` 0 = nearest to the box's centre, 1 = on the surface
// facing the camera. The box's centre if the ray misses the box.
Eigen::Vector3d PointOnRay(const GroundView& view,
                           const geometry::Box3& box,
                           const Eigen::Vector2d& pixel_px,
                           double depth);

// Covariance on the ground (in PlaneAxes) that an uncertain camera pose causes
// for the point p_world seen at a given pixel.
//   covariance  of (dp, dtheta) as rigid3.h says.
Eigen::Matrix2d GroundCovarianceFromPose(const GroundView& view,
                                         const Eigen::Vector3d& p_world,
                                         const geometry::Matrix6d& covariance);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BOX_FIT_H_
