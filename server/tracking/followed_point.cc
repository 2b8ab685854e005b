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

}  // namespace

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
