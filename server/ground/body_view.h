// SPDX-License-Identifier: Apache-2.0
// A moment in which a body was seen, and what is known of it there. Lengths in
// metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_VIEW_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_VIEW_H_

#include <Eigen/Core>
#include <optional>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"

namespace groundlock::ground {

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

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_VIEW_H_
