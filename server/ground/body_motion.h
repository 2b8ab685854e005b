// SPDX-License-Identifier: Apache-2.0
// Structure and motion of a rigid body that goes along the ground, from points
// of it that were followed in the image. Lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_MOTION_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_MOTION_H_

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"

namespace groundlock::ground {

// Over so many of a body's sides along its way what is wrong with the ground's
// height and tilt becomes something else (e-fold).
inline constexpr double kGroundSides = 2.0;

// A moment in which a body was seen.
struct BodyView {
  geometry::CameraModel camera;
  geometry::Rigid3 world_from_camera;
  // Where the body is taken to stand: its frame has x along the heading and z
  // up, its origin lies on the ground.
  geometry::Rigid3 world_from_body;
  // Of that place along each axis of the ground, and of the heading.
  double place_sigma_m = 1.0;
  double heading_sigma_rad = 1.0;
  // Of the ground there: its rise along the body's z and its tilt about the
  // body's x and y; zero where it is known.
  Eigen::Matrix3d ground_covariance = Eigen::Matrix3d::Zero();
  // Its silhouette, if that was measured.
  std::optional<SeenOutline> outline = std::nullopt;
};

// What a body is taken to be like.
struct BodyForm {
  Eigen::Vector3d size_m = Eigen::Vector3d::Ones();
  BodyShape shape = {};
  double size_sigma = 0.0;  // of its extents, of each
};

// One point of the body in the views in which it was followed.
struct BodyTrack {
  struct Observation {
    std::size_t view = 0;
    Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
  };
  std::vector<Observation> observations;
};

struct BodyMotion {
  // Of each view, better than it was.
  std::vector<geometry::Rigid3> world_from_body;
  // In the body's frame, those that go with the body, and of which tracks.
  std::vector<BodyPoint> points;
  std::vector<std::size_t> tracks;
  std::size_t seen_in_first = 0;  // so many of them in the first view
};

// Bundle adjustment over the points and, in each view, the body's place and
// heading on the ground, and the ground's own rise and tilt where these are not
// known, as maximum a posteriori: the views' poses as they are given, the
// ground's errors a Gauss-Markov process over the way (kGroundSides; as large
// as the diagonals of the views' ground_covariance), the points about the
// surface of a body of that form, which projects to
// the outlines that were seen, and it goes along
// its heading where its rear axle is (without slip: the points err alike, and
// would let it turn by too much or too little). A track that a point at rest
// explains better is none of the body's. What is seen
// leaves the scale open as far as the camera stands, for everything could be
// nearer and smaller: the poses given decide then, and a fit of a body to the
// points has to find it (BodyKnowledge::scale_sigma).
// nullopt: too few points go with the body. Thread-safe. 3 to 6 ms with 24
// views and 80 points on known ground. Source: Triggs, McLauchlan, Hartley,
// Fitzgibbon 2000, "Bundle adjustment: a modern synthesis" (reduced camera
// system, §6; robust weights, §3.2); Kong, Pfeiffer, Schildbach, Borrelli 2015,
// "Kinematic and dynamic vehicle models for autonomous driving control design",
// §II (no slip at the rear axle).
std::optional<BodyMotion> SolveBodyMotion(std::span<const BodyView> views,
                                          std::span<const BodyTrack> tracks,
                                          const BodyForm& form);

// A known point of a body, as seen in one view.
struct BodySighting {
  Eigen::Vector3d p_body = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
};

struct BodyPose {
  geometry::Rigid3 world_from_body;
  // Of the place along the body's x and y, and of its heading (m, m, rad).
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Identity();
  // The ground's rise and tilt off the view's pose (BodyView), which
  // world_from_body has.
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();
  Eigen::Matrix3d ground_covariance = Eigen::Matrix3d::Zero();
  std::vector<bool> agrees;  // is each point where the pose has it?
  std::size_t agreeing = 0;  // so many are
};

// Where on the ground a body stands whose points are seen: maximum a posteriori
// about the pose in `predicted`. If the ground's height and tilt are not known
// there, these as well: how large the body looks tells its distance, and so how
// high it stands.
//   sigma_px  of a point, that of its place on the body included; within three
//     of these it agrees.
// nullopt: fewer than three points, or they do
// not project. Thread-safe.
std::optional<BodyPose> LocateBody(const BodyView& predicted,
                                   std::span<const BodySighting> seen,
                                   double sigma_px);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_MOTION_H_
