// SPDX-License-Identifier: Apache-2.0
// By how much the ground under a body is other than it is said to be.
#ifndef GROUNDLOCK_SERVER_TRACKING_GROUND_ERRORS_H_
#define GROUNDLOCK_SERVER_TRACKING_GROUND_ERRORS_H_

#include <Eigen/Core>
#include <cmath>

namespace groundlock::tracking {

// Where ground varies, its height is known to a few centimetres only, and its
// slope to a few degrees. That is half a metre of distance where it is seen at
// a grazing angle, and a body that is known looks larger or smaller, and
// turned, as it would not there. So the errors are a state: a first-order
// Gauss-Markov process over the way that the body goes (Gelb 1974, "Applied
// optimal estimation", section 3.8), about zero, as large as the surface says.
// Of three: the rise along the vertical (metres or map units), and the tilt
// about the two axes of the surface's reference plane (rad; of its vector the
// part along these). Not thread-safe.
struct GroundErrors {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();

  double rise_m() const { return mean[0]; }
  Eigen::Vector2d tilt_rad() const { return mean.tail<2>(); }

  //   lengths  how far it went, in lengths over which the errors become others.
  //   sigmas  of the surface's height and tilt there.
  void GoOn(double lengths, const Eigen::Vector3d& sigmas) {
    const double stays = std::exp(-lengths);
    mean *= stays;
    covariance *= stays * stays;
    covariance.diagonal() += (1.0 - stays * stays) * sigmas.cwiseAbs2();
  }
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_GROUND_ERRORS_H_
