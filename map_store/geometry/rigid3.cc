// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/rigid3.h"

#include <cmath>

namespace groundlock::geometry {

Eigen::Matrix<double, 3, 4> Rigid3::Matrix3x4() const {
  Eigen::Matrix<double, 3, 4> matrix;
  matrix.leftCols<3>() = rotation.toRotationMatrix();
  matrix.col(3) = translation;
  return matrix;
}

double AngleBetween_rad(const Eigen::Quaterniond& a,
                        const Eigen::Quaterniond& b) {
  const Eigen::Quaterniond difference = a.conjugate() * b;
  return 2.0 * std::atan2(difference.vec().norm(), std::abs(difference.w()));
}

Eigen::Vector3d RotationVector(const Eigen::Quaterniond& q) {
  // q and -q are the same rotation: the one with w >= 0 has angle <= pi.
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  const double sine = q.vec().norm();
  const double cosine = sign * q.w();
  // Below, atan2(s, c) = s / c to the last bit.
  const double factor =
      sine < 1e-9 ? 2.0 / cosine : 2.0 * std::atan2(sine, cosine) / sine;
  return sign * factor * q.vec();
}

Eigen::Quaterniond QuaternionFromRotationVector(const Eigen::Vector3d& v_rad) {
  const double angle = v_rad.norm();
  // sin(a / 2) / a = 1/2 - a^2/48 + ...: the second term is below 1e-19.
  const double factor = angle < 1e-9 ? 0.5 : std::sin(0.5 * angle) / angle;
  Eigen::Quaterniond q;
  q.w() = std::cos(0.5 * angle);
  q.vec() = factor * v_rad;
  return q.normalized();
}

Eigen::Matrix3d Skew(const Eigen::Vector3d& a) {
  Eigen::Matrix3d matrix;
  // clang-format off
  matrix <<    0.0, -a.z(),  a.y(),
             a.z(),    0.0, -a.x(),
            -a.y(),  a.x(),    0.0;
  // clang-format on
  return matrix;
}

}  // namespace groundlock::geometry
