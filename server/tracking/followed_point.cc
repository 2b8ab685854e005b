// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/followed_point.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace groundlock::tracking {
namespace {

// As the view turns by 30 degrees, any point may be followed; smaller turns
// than the other are errors of the heading.
constexpr double kAnyAfter_rad = 30.0 * std::numbers::pi / 180.0;
constexpr double kTurnError_rad = 3.0 * std::numbers::pi / 180.0;
// By how much it goes astray in a second where the view does not turn: a
// correlation filter's finds in real flights, which wander by 5 % of the side
// in three.
constexpr double kAstray_per_sqrt_s = 0.03;

// Where fits to points have a body is off by so much of its side (rms of 45
// fits each in 14 drives: 0.09 along it, 0.06 across), about the same for as
// long as what silhouettes tell (ground_target_outline.cc).
constexpr double kFitSigma = 0.08;
constexpr double kFitTime_s = 1.0;

}  // namespace

double FollowedPoint::TellByFit(std::chrono::nanoseconds time, bool is_linked) {
  double told = kFitSigma * kFitSigma;
  double gain = 1.0;
  if (fit_time_ && is_linked) {
    const double step_s =
        std::chrono::duration<double>(time - *fit_time_).count();
    told *= std::max(1.0, kFitTime_s / std::max(step_s, 1e-3));
    gain = variance_ / (variance_ + told);
  }
  variance_ = gain * told;
  fit_time_ = time;
  return gain;
}

void FollowedPoint::Follow(const Eigen::Vector3d& to_eye,
                           std::chrono::nanoseconds time) {
  if (!to_eye_) {
    to_eye_ = to_eye;
    time_ = time;
  }
  const double turn_rad =
      std::acos(std::clamp(to_eye.dot(*to_eye_), -1.0, 1.0));
  if (turn_rad > kTurnError_rad) {
    variance_ += kAnyVariance * turn_rad / kAnyAfter_rad;
    to_eye_ = to_eye;
  }
  const double step_s =
      std::max(0.0, std::chrono::duration<double>(time - time_).count());
  variance_ += kAstray_per_sqrt_s * kAstray_per_sqrt_s * step_s;
  variance_ = std::min(variance_, kAnyVariance);
  time_ = time;
}

}  // namespace groundlock::tracking
