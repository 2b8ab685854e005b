// SPDX-License-Identifier: Apache-2.0
// How much larger a target looks in the image than the ground says.
#ifndef GROUNDLOCK_SERVER_TRACKING_OUTLINE_SCALE_H_
#define GROUNDLOCK_SERVER_TRACKING_OUTLINE_SCALE_H_

#include <Eigen/Core>
#include <algorithm>

namespace groundlock::tracking {

// A Kalman filter over the logarithm of that ratio, which has three parts:
//
//   body    the body is larger than it was taken for: constant
//   ground  the ground is not where it is said to be, so that the body stands
//           nearer or farther: a first-order Gauss-Markov process
//   drift   a 2D tracker's own scale goes astray: a slow random walk
//
// The tracker sees the sum of all three. Body and ground together are how large
// the target looks; so a body that was measured wrongly is mended over the
// whole track, and where the ground is wrong the image wins. Not thread-safe.
class OutlineScale {
 public:
  //   body_sigma  how well the body's size is known, relatively; where that is
  //               not told, as well as a box in the image lets one guess it.
  explicit OutlineScale(double body_sigma = kGuessedBodySigma)
      : body_sigma_(std::min(body_sigma, kGuessedBodySigma)) {
    Restart(0.0);
  }

  // The target is known to look exp(log_ratio) times as large as the body that
  // is taken for it would.
  void Restart(double log_ratio);
  // The body was measured by other means, and looks as large as it is.
  void RestartMeasured();
  void Predict(double step_s);
  // It is seen that much larger than the body looks.
  void Observe(double log_ratio);
  // How much larger than the body the target looks.
  double ratio() const;
  // By how much the body is larger than it was taken for. The caller changes
  // the body by that, and what follows is in relation to the changed one.
  double TakeBody();

 private:
  friend struct StateFields;

  // Estimated from a few tracks (docs/method.md, "Size"). From its first box a
  // rendered car of 0.9 x 0.5 x 0.35 m was fitted as 0.78 x 0.59 x 0.29.
  static constexpr double kGuessedBodySigma = 0.15;

  enum Part { kBody, kGround, kDrift };
  void Start(double body_sigma);
  void Measure(double log_ratio, double sigma);

  double body_sigma_;
  double step_s_ = 0.0;  // since the last prediction
  Eigen::Vector3d mean_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_ = Eigen::Matrix3d::Zero();
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_OUTLINE_SCALE_H_
