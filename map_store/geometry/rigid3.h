// SPDX-License-Identifier: Apache-2.0
// Rigid transforms, named target_from_source so that adjacent names cancel:
//   p_world = world_from_camera * p_camera.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_RIGID3_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_RIGID3_H_

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace groundlock::geometry {

using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

// target_from_source: x_target = rotation * x_source + translation.
struct Rigid3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Rigid3 Inverse() const {
    const Eigen::Quaterniond inverse = rotation.conjugate();
    return {inverse, -(inverse * translation)};
  }
  Eigen::Matrix<double, 3, 4> Matrix3x4() const;
  bool IsFinite() const {
    return rotation.coeffs().allFinite() && translation.allFinite();
  }
};

inline Eigen::Vector3d operator*(const Rigid3& target_from_source,
                                 const Eigen::Vector3d& p_source) {
  return target_from_source.rotation * p_source +
         target_from_source.translation;
}

// c_from_a = c_from_b * b_from_a. The rotation is renormalised.
inline Rigid3 operator*(const Rigid3& c_from_b, const Rigid3& b_from_a) {
  return {(c_from_b.rotation * b_from_a.rotation).normalized(),
          c_from_b.rotation * b_from_a.translation + c_from_b.translation};
}

// Angle of the rotation between two orientations, in [0, pi] rad.
// The unit is part of the name, as in variables.
// NOLINTNEXTLINE(readability-identifier-naming)
double AngleBetween_rad(const Eigen::Quaterniond& a,
                        const Eigen::Quaterniond& b);

// Rotation vector (axis times angle, rad, angle in [0, pi]) and back.
Eigen::Vector3d RotationVector(const Eigen::Quaterniond& q);
Eigen::Quaterniond QuaternionFromRotationVector(const Eigen::Vector3d& v_rad);

// Cross-product matrix: Skew(a) * b = a x b.
Eigen::Matrix3d Skew(const Eigen::Vector3d& a);

// Uncertainty of world_from_camera is a 6x6 covariance of (dp, dtheta):
// dp = error of the camera centre in world (m), dtheta = error of the rotation
// as a rotation vector in world (rad): R_true = Exp(dtheta) R_estimated.

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_RIGID3_H_
