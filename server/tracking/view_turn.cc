// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/view_turn.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/tracking/body_size.h"

namespace groundlock::tracking {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// A correlation filter sees a target that is turned by this as if it were not
// (docs/method.md, "A turned view"); less than the other is not turned either,
// so that no noise turns it to and fro.
constexpr double kTurned_rad = 8.0 * kDegree;
constexpr double kNotTurned_rad = 5.0 * kDegree;
// Seen from steeper than this, a target has no upright in the image.
constexpr double kUpright_rad = 60.0 * kDegree;
// A filter that learns follows a target that turns so fast.
constexpr double kReturn_rad_s = 20.0 * kDegree;

using Projection = Eigen::Matrix<double, 2, 3>;

// Of a body seen so, squared and along its axes: across the view its whole
// width, along the view as much as its top shows of that, and its height as far
// as that is not foreshortened. Which of its sides is the longer one may be
// learnt meanwhile, so both count alike.
Eigen::Matrix3d SquaredExtent(const ViewTurn::View& view) {
  const double sine = view.to_eye.z();
  const double cosine = view.to_eye.head<2>().norm();
  Eigen::Vector3d along = Eigen::Vector3d::UnitX();
  if (cosine > 0.0) along << view.to_eye.head<2>() / cosine, 0.0;
  const Eigen::Vector3d across = along.cross(Eigen::Vector3d::UnitZ());
  const auto extent_m2 = [](const Eigen::Vector3d& axis, double length_m) {
    return Eigen::Matrix3d(length_m * length_m * axis * axis.transpose());
  };
  return extent_m2(across, view.width_m) +
         extent_m2(along, sine * view.width_m) +
         extent_m2(Eigen::Vector3d::UnitZ(), cosine * view.height_m);
}

bool IsFromAbove(const ViewTurn::View& view) {
  return std::abs(view.to_eye.z()) > std::sin(kUpright_rad);
}

}  // namespace

void ViewTurn::Follow(const View& view) {
  now_ = view;
  if (!learnt_) return;
  if (learnt_->is_upright && !IsFromAbove(view)) {
    turn_rad_ = WrapAngle_rad(view.lean_rad - *usual_lean_rad_);
  } else {
    const Eigen::Matrix2d product =
        view.px_per_m * learnt_->extent_m2 * learnt_->px_per_m.transpose();
    turn_rad_ = std::atan2(product(1, 0) - product(0, 1), product.trace());
  }
  is_turned_ =
      std::abs(turn_rad_) > (is_turned_ ? kNotTurned_rad : kTurned_rad);
}

void ViewTurn::Learn(double step_s) {
  if (!now_) return;
  double learnt_rad = turn_rad_;
  bool is_upright = false;
  if (!IsFromAbove(*now_)) {
    if (!usual_lean_rad_) usual_lean_rad_ = now_->lean_rad - learnt_rad;
    const double off_rad =
        WrapAngle_rad(now_->lean_rad - *usual_lean_rad_ - learnt_rad);
    const double most_rad = kReturn_rad_s * std::max(step_s, 0.0);
    is_upright = std::abs(off_rad) <= most_rad;
    learnt_rad += std::clamp(off_rad, -most_rad, most_rad);
  }
  const Eigen::Rotation2Dd back(-learnt_rad);
  learnt_ = Learnt{back.toRotationMatrix() * now_->px_per_m,
                   SquaredExtent(*now_),
                   is_upright};
  now_.reset();
}

}  // namespace groundlock::tracking
