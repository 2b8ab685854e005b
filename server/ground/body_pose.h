// SPDX-License-Identifier: Apache-2.0
// Where on the ground a body stands that is known already, from points of it in
// one view. Lengths in metres or map units.
#ifndef GROUNDLOCK_SERVER_GROUND_BODY_POSE_H_
#define GROUNDLOCK_SERVER_GROUND_BODY_POSE_H_

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/rigid3.h"
#include "server/ground/body_view.h"

namespace groundlock::ground {

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

#endif  // GROUNDLOCK_SERVER_GROUND_BODY_POSE_H_
