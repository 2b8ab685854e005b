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

#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"
#include "server/ground/body_view.h"

namespace groundlock::ground {

// Over so many of a body's sides along its way what is wrong with the ground's
// height and tilt becomes something else (e-fold).
inline constexpr double kGroundSides = 2.0;

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

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_MOTION_H_
