// SPDX-License-Identifier: Apache-2.0
// Least squares on the reprojection error, and what it says about the pose.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_REFINEMENT_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_REFINEMENT_H_

#include <Eigen/Core>
#include <optional>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::localization {

// Error of one landmark's projection, in pixels of the real, distorted image:
// projection minus pixel_px. nullopt if the landmark does not project.
//   jacobian  if given, exact, with respect to (dp, dtheta) at zero: camera
//             centre + dp, rotation Exp(dtheta) R (see rigid3.h).
std::optional<Eigen::Vector2d> ReprojectionResidual(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const Eigen::Vector3d& p_world,
    const Eigen::Vector2d& pixel_px,
    Eigen::Matrix<double, 2, 6>* jacobian);

struct PoseRefinementOptions {
  // Cauchy's loss c^2 log(1 + r^2 / c^2): residuals well below c count fully.
  // Half the inlier gate, so that what passes the gate by chance counts little.
  double loss_scale_px = 1.0;
  int max_iterations = 20;
  absl::Status Validate() const;  // names field, value and bound
};

struct RefinedPose {
  geometry::Rigid3 world_from_camera;
  // Of (dp, dtheta) as rigid3.h says, scaled by the residuals' own variance.
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
  double mean_error_px = 0.0;
  int iterations = 0;
};

// Minimises the robust reprojection error over the pose alone.
//   p_world, pixel_px  N >= 4 correspondences, all of which project at
//                      `initial`.
// Errors: kInvalidArgument if sizes differ; kFailedPrecondition if N < 4, a
//   landmark does not project, or the points do not fix all six degrees of
//   freedom.
// Source of the covariance: Huber 1981, §7.6 (M-estimators).
absl::StatusOr<RefinedPose> RefinePose(
    const geometry::CameraModel& camera,
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector2d> pixel_px,
    const geometry::Rigid3& initial_world_from_camera,
    const PoseRefinementOptions& options);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_REFINEMENT_H_
