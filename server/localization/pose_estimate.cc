// SPDX-License-Identifier: Apache-2.0
#include "server/localization/pose_estimate.h"

#include <Eigen/Cholesky>

namespace groundlock::localization {

using geometry::Matrix6d;
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

Matrix6d TransportCovariance(const PoseEstimate& from,
                             const Eigen::Vector3d& to_center_world) {
  // dp_to = dp_from + dtheta x (to - from).
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() =
      -geometry::Skew(to_center_world - from.world_from_camera.translation);
  return J * from.covariance * J.transpose();
}

PoseEstimate FusePoses(const PoseEstimate& predicted,
                       const PoseEstimate& measured,
                       double max_mahalanobis_squared) {
  const Vector6d innovation =
      PoseDifference(predicted.world_from_camera, measured.world_from_camera);
  const Matrix6d S = predicted.covariance + measured.covariance;
  const Eigen::LDLT<Matrix6d> solver(S);
  if (solver.info() != Eigen::Success || !(solver.vectorD().minCoeff() > 0.0) ||
      !(innovation.dot(solver.solve(innovation)) <= max_mahalanobis_squared)) {
    return measured;
  }
  // K = P S^-1; Joseph's form keeps the covariance symmetric and positive.
  const Matrix6d K = solver.solve(predicted.covariance).transpose();
  const Matrix6d A = Matrix6d::Identity() - K;
  return {MovePose(predicted.world_from_camera, K * innovation),
          A * predicted.covariance * A.transpose() +
              K * measured.covariance * K.transpose()};
}

}  // namespace groundlock::localization
