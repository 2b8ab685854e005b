// SPDX-License-Identifier: Apache-2.0
// A pose with its uncertainty, and how two of them become one.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_POSE_ESTIMATE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_POSE_ESTIMATE_H_

#include "map_store/geometry/rigid3.h"

namespace groundlock::localization {

struct PoseEstimate {
  geometry::Rigid3 world_from_camera;
  // Of (dp, dtheta), see rigid3.h.
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
};

// `to` minus `from` as (dp, dtheta).
geometry::Vector6d PoseDifference(const geometry::Rigid3& from_pose,
                                  const geometry::Rigid3& to_pose);
// `pose` moved by (dp, dtheta).
geometry::Rigid3 MovePose(const geometry::Rigid3& pose,
                          const geometry::Vector6d& difference);

// The error that a pose inherits from an earlier one to which it was measured
// relatively: a turned beginning also displaces the end.
geometry::Matrix6d TransportCovariance(const PoseEstimate& from,
                                       const Eigen::Vector3d& to_center_world);

// Two independent estimates of one pose (Kalman update). If they contradict
// each other beyond max_mahalanobis_squared, `measured` alone is returned.
// Thread-safe.
PoseEstimate FusePoses(const PoseEstimate& predicted,
                       const PoseEstimate& measured,
                       double max_mahalanobis_squared);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_POSE_ESTIMATE_H_
