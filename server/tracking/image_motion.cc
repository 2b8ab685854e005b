// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/image_motion.h"

#include <algorithm>
#include <cmath>

namespace groundlock::tracking {
namespace {

constexpr double kVelocityRate = 0.3;
constexpr double kInnovationRate = 0.1;
constexpr double kFirstSigma = 0.5;  // of the box's side
// Unseen, a velocity in the image, which is mostly the camera's, soon means
// nothing.
constexpr double kVelocityLife_s = 0.4;
constexpr double kWidestSigma = 4.0;  // of the box's side

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

}  // namespace

void ImageMotion::Restart(const geometry::Box2& box_px,
                          std::chrono::nanoseconds time) {
  center_px_ = box_px.center_px();
  velocity_px_s_.setZero();
  side_px_ = std::sqrt(box_px.size_px().prod());
  innovation_px2_ = std::pow(kFirstSigma * side_px_, 2);
  time_ = time;
}

void ImageMotion::Update(const geometry::Box2& box_px,
                         std::chrono::nanoseconds time) {
  const double step_s = Seconds(time - time_);
  if (!(step_s > 0.0)) return;
  const Eigen::Vector2d way_px = box_px.center_px() - center_px_;
  const Eigen::Vector2d surprise_px = way_px - velocity_px_s_ * step_s;
  innovation_px2_ +=
      kInnovationRate * (0.5 * surprise_px.squaredNorm() - innovation_px2_);
  velocity_px_s_ += kVelocityRate * (way_px / step_s - velocity_px_s_);
  side_px_ = std::sqrt(box_px.size_px().prod());
  center_px_ = box_px.center_px();
  step_s_ = step_s;
  time_ = time;
}

ImageMotion::Prediction ImageMotion::Predict(
    std::chrono::nanoseconds time) const {
  const double age_s = std::max(0.0, Seconds(time - time_));
  Prediction prediction;
  prediction.center_px =
      center_px_ + velocity_px_s_ * kVelocityLife_s *
                       (1.0 - std::exp(-age_s / kVelocityLife_s));
  const double steps = std::max(1.0, age_s / step_s_);
  const double sigma_px =
      std::min(kWidestSigma * side_px_, std::sqrt(innovation_px2_) * steps);
  prediction.covariance_px2 = sigma_px * sigma_px * Eigen::Matrix2d::Identity();
  return prediction;
}

}  // namespace groundlock::tracking
