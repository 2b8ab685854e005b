// SPDX-License-Identifier: Apache-2.0
// The frame path's pose solver: a few hundred 2D-3D observations around a good
// prediction, in well under a millisecond.
//
// solvers/ holds what makes a pose of places in the world and pixels in which
// they are seen, whoever found them; it knows neither maps nor images:
//   robust_pose      from a good prediction, with wrong observations among them
//   pose_refinement  to the last digit (Ceres), and a residual's derivatives
//   normal_matrix    what the refinements by reweighting share
//   pose_estimate    a pose and its covariance; steps from pose to pose
// From nothing, three points at a time, is map_store/geometry/pose_ransac.h.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_ROBUST_POSE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_ROBUST_POSE_H_

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::localization {

struct PoseObservation {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
  double weight = 1.0;  // inverse variance, relative to the others
};

// What was expected of the pose.
struct ExpectedPose {
  geometry::Rigid3 world_from_camera;
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();  // (dp, dtheta)
};

struct RobustPoseOptions {
  int max_iterations = 12;
  // Gate of the first iterations; it narrows to final_gate_px, so that a
  // prediction that is off by some pixels still gathers its inliers.
  double initial_gate_px = 16.0;
  double final_gate_px = 2.5;
  // Narrower still where the residuals are smaller, as the biweight wants it,
  // but not below this; 0: final_gate_px whatever they are.
  double least_gate_px = 0.0;
  // Helps to tell which observations are right, and is no part of the result:
  // a few with a long lever, such as near landmarks before a far wall, could
  // else pull the pose to where they fit. From there the pose is refined
  // without it, and each observation is judged by where the others put it:
  // where little is expected, one with a long lever would else agree with the
  // pose that it makes.
  std::optional<ExpectedPose> expected = std::nullopt;
};

struct RobustPose {
  geometry::Rigid3 world_from_camera;
  // Of (dp, dtheta), see rigid3.h: residual variance times the inverse of the
  // normal matrix. Observations are taken as independent; callers add what they
  // know of common errors.
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
  std::vector<char> is_inlier;  // per observation
  int num_inliers = 0;
  double rms_error_px = 0.0;   // of the inliers
  double mean_error_px = 0.0;  // of the inliers
};

// Iteratively reweighted Gauss-Newton with Tukey's biweight on the reprojection
// error. nullopt if fewer than six observations agree or the normal matrix is
// singular. Thread-safe.
// Source: Holland & Welsch 1977 (weights); Hartley & Zisserman, 2nd ed., A6;
// Cook & Weisberg 1982, section 2.2 (residuals of long levers).
std::optional<RobustPose> RefinePoseRobustly(
    const geometry::CameraModel& camera,
    std::span<const PoseObservation> observations,
    const geometry::Rigid3& initial_world_from_camera,
    const RobustPoseOptions& options);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_ROBUST_POSE_H_
