// SPDX-License-Identifier: Apache-2.0
// How a body stands off the pose that its view is given with, and what is seen
// of it then: what the adjustment of many views and the pose in one share.
#ifndef GROUNDLOCK_SERVER_GROUND_INTERNAL_VIEW_POSE_H_
#define GROUNDLOCK_SERVER_GROUND_INTERNAL_VIEW_POSE_H_

#include <Eigen/Core>
#include <array>
#include <optional>

#include "map_store/geometry/rigid3.h"
#include "server/ground/body_motion.h"
#include "server/ground/body_view.h"

namespace groundlock::ground::internal {

// Place on the ground (2, along the body's x and y) and turn, and the ground's
// own errors: its rise, and its tilt about the body's x and y.
inline constexpr int kNumPose = 6;
using Pose = Eigen::Matrix<double, kNumPose, 1>;
using PoseJacobian = Eigen::Matrix<double, 2, kNumPose>;
using PoseNormal = Eigen::Matrix<double, kNumPose, kNumPose>;
inline constexpr int kGround = 3;  // the first of the ground's

// Where a point is seen, less where a body has it that stands off its view's
// pose; nullopt: it does not project. All of this is thread-safe.
//   by_pose, by_point  derivatives, both or neither.
std::optional<Eigen::Vector2d> ProjectionError_px(
    const BodyView& view,
    const Pose& pose,
    const Eigen::Vector3d& p_body,
    const Eigen::Vector2d& pixel_px,
    PoseJacobian* by_pose = nullptr,
    Eigen::Matrix<double, 2, 3>* by_point = nullptr);

geometry::Rigid3 Moved(const geometry::Rigid3& world_from_body,
                       const Pose& pose);

// What is known of the ground is known as well as can be reckoned with.
Eigen::Matrix3d GroundCovariance(const BodyView& view);
// Inverse variances of place and turn.
Eigen::Vector3d PriorWeights(const BodyView& view);

// Cauchy's cost of a squared error in standard deviations, and his weights, of
// an error in standard deviations, and of one of a pixel
// (in 1 / px^2).
double RobustCost(double squared);
double RobustWeight(double sigmas);
double RobustWeight(const Eigen::Vector2d& error_px, double sigma_px);

// How far the edges of a body that stands off its view's pose are from those
// that were seen, in standard deviations.
struct OutlineErrors {
  struct Edge {
    double sigmas = 0.0;
    Pose by_pose = Pose::Zero();
  };
  std::array<Edge, 4> edges;
  int count = 0;
};
OutlineErrors ErrorsOfOutline(const BodyView& view,
                              const Pose& pose,
                              const BodyForm& form);

}  // namespace groundlock::ground::internal

#endif  // GROUNDLOCK_SERVER_GROUND_INTERNAL_VIEW_POSE_H_
