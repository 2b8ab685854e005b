// SPDX-License-Identifier: Apache-2.0
// A pose with its uncertainty, and the difference of two.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_ESTIMATE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_ESTIMATE_H_

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

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_POSE_ESTIMATE_H_
