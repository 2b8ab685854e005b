// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/pose_estimate.h"

namespace groundlock::localization {

using geometry::Rigid3;
using geometry::Vector6d;

Vector6d PoseDifference(const Rigid3& from_pose, const Rigid3& to_pose) {
  Vector6d difference;
  difference << to_pose.translation - from_pose.translation,
      geometry::RotationVector(to_pose.rotation *
                               from_pose.rotation.conjugate());
  return difference;
}

Rigid3 MovePose(const Rigid3& pose, const Vector6d& difference) {
  return {(geometry::QuaternionFromRotationVector(difference.tail<3>()) *
           pose.rotation)
              .normalized(),
          pose.translation + difference.head<3>()};
}

}  // namespace groundlock::localization
