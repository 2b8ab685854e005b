// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/outline_scale.h"

#include <algorithm>
#include <cmath>

namespace groundlock::tracking {
namespace {

// Relative standard deviations, estimated from a few tracks (docs/method.md,
// "Size").
// Points of a body at rest tell its size so well (docs/method.md, "A body at
// rest").
constexpr double kMeasuredSigma = 0.03;
// A ground that is off by so much of the camera's height makes a body look as
// much too large or small; it stays so for about the time in which a camera or
// a target goes on to another stretch of ground. Behind car10 it came to 30 %
// within 24 s.
constexpr double kGroundSigma = 0.15;
constexpr double kGroundTime_s = 10.0;
// A tracker's own scale goes astray by so much in a second (per root of it):
// behind car10 it ended within 7 % after 47 s.
constexpr double kDriftSigma = 0.01;
// A person's box fits its target so well.
constexpr double kStartSigma = 0.02;
// A tracker's does so well, with errors that last for about so long: frames in
// quick succession say no more than a few.
constexpr double kSeenSigma = 0.05;
constexpr double kSeenTime_s = 1.0;

}  // namespace

void OutlineScale::Restart(double log_ratio) {
  Start(body_sigma_);
  Measure(log_ratio, kStartSigma);
}

void OutlineScale::RestartMeasured() {
  Start(std::min(body_sigma_, kMeasuredSigma));
  Measure(0.0, kStartSigma);
}

void OutlineScale::Start(double body_sigma) {
  mean_.setZero();
  covariance_ =
      Eigen::Vector3d(body_sigma, kGroundSigma, 0.0).cwiseAbs2().asDiagonal();
}

void OutlineScale::Predict(double step_s) {
  step_s_ = step_s;
  const double stays = std::exp(-step_s / kGroundTime_s);
  mean_[kGround] *= stays;
  covariance_.row(kGround) *= stays;
  covariance_.col(kGround) *= stays;
  covariance_(kGround, kGround) +=
      kGroundSigma * kGroundSigma * (1.0 - stays * stays);
  covariance_(kDrift, kDrift) += kDriftSigma * kDriftSigma * step_s;
}

void OutlineScale::Observe(double log_ratio) {
  const double frames = std::max(1.0, kSeenTime_s / std::max(step_s_, 1e-3));
  Measure(log_ratio, kSeenSigma * std::sqrt(frames));
}

void OutlineScale::Measure(double log_ratio, double sigma) {
  const Eigen::RowVector3d H = Eigen::RowVector3d::Ones();
  const double variance = H * covariance_ * H.transpose() + sigma * sigma;
  const Eigen::Vector3d gain = covariance_ * H.transpose() / variance;
  mean_ += gain * (log_ratio - mean_.sum());
  // Joseph's form, which stays positive definite.
  const Eigen::Matrix3d rest = Eigen::Matrix3d::Identity() - gain * H;
  covariance_ = rest * covariance_ * rest.transpose() +
                sigma * sigma * gain * gain.transpose();
}

double OutlineScale::ratio() const {
  return std::exp(mean_[kBody] + mean_[kGround]);
}

double OutlineScale::TakeBody() {
  const double factor = std::exp(mean_[kBody]);
  mean_[kBody] = 0.0;
  return factor;
}

}  // namespace groundlock::tracking
