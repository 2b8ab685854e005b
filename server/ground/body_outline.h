// SPDX-License-Identifier: Apache-2.0
// What a silhouette tells of a body that is known already. Lengths in metres or
// map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_OUTLINE_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_OUTLINE_H_

#include <Eigen/Core>
#include <optional>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/box_fit.h"

namespace groundlock::ground {

// A body on the ground, as well as it is known.
struct StandingBody {
  // Its frame has x along the heading and z up, its origin lies on the ground.
  geometry::Rigid3 world_from_body;
  Eigen::Vector3d size_m = Eigen::Vector3d::Ones();
  BodyShape shape;
  // Of the place along its x and y, its heading, and the logarithms of length,
  // width and height.
  geometry::Matrix6d covariance = geometry::Matrix6d::Identity();
  // Of the silhouette last taken: the squared Mahalanobis distance of its edges
  // from where they were foretold, chi-square of as many degrees.
  double surprise = 0.0;
};

// What of a silhouette is taken: its four edges, or only how wide and high it
// is, which tells a body's size, wherever exactly that is.
enum class OutlinePart { kEdges, kSize };

// The same after a silhouette of it was seen: maximum a posteriori, the
// iterated update of an extended Kalman filter (Bell & Cathey 1993, "The
// iterated Kalman filter update as a Gauss-Newton method") with Cauchy's
// weights.
//   times  by which the silhouette's errors are larger than usual, for one that
//     shares them with others.
// nullopt: the body does not project. Thread-safe.
std::optional<StandingBody> FitToOutline(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const StandingBody& before,
    const SeenOutline& seen,
    OutlinePart part,
    double times = 1.0);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_OUTLINE_H_
