// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/camera_paths.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace groundlock::simulator {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Rigid3;

Rigid3 LookAt(const Vector3d& eye,
              const Vector3d& target,
              double roll_rad,
              const Vector3d& up) {
  const Vector3d forward = (target - eye).normalized();
  const Vector3d right = forward.cross(up).normalized();
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  R = R * Eigen::AngleAxisd(roll_rad, Vector3d::UnitZ()).toRotationMatrix();
  return {Eigen::Quaterniond(R), eye};
}

Shake::Shake(const Terrain& terrain, std::uint64_t seed, double period_s)
    : terrain_(terrain) {
  std::mt19937_64 random(seed);
  // Not std::uniform_real_distribution: its values depend on the library.
  const auto unit = [&] {
    return static_cast<double>(random() >> 11U) * 0x1.0p-53;
  };
  for (Axis& axis : axes_) {
    for (std::size_t i = 0; i < axis.waves.size(); ++i) {
      double frequency_hz = 0.25 * std::pow(2.1, i) * (0.8 + 0.4 * unit());
      if (period_s > 0.0) {
        frequency_hz = std::round(frequency_hz * period_s) / period_s;
      }
      axis.waves[i] = {2 * std::numbers::pi * frequency_hz,
                       2 * std::numbers::pi * unit(),
                       std::pow(0.5, i) * (0.6 + 0.4 * unit())};
    }
  }
}

double Shake::At(int axis, double t_s) const {
  double sum = 0.0;
  for (const Wave& wave : axes_[axis].waves) {
    sum += wave.amplitude * std::sin(wave.rate * t_s + wave.phase);
  }
  return 0.6 * sum;
}

Rigid3 Shake::Apply(const Vector3d& level_eye,
                    const Vector3d& level_target,
                    double t_s,
                    double roll_rad,
                    const Vector3d& up) const {
  const Vector3d eye = terrain_.Lift(level_eye);
  const Vector3d target = terrain_.Lift(level_target);
  constexpr double kSway_m = 0.025;
  constexpr double kTurn = 0.011;  // rad
  const Vector3d sway(At(0, t_s), At(1, t_s), 0.8 * At(2, t_s));
  const double distance = (target - eye).norm();
  const Vector3d side = (target - eye).cross(up).normalized() * distance;
  const Vector3d aim =
      target + kTurn * At(3, t_s) * side + kTurn * distance * At(4, t_s) * up;
  return LookAt(
      eye + kSway_m * sway, aim, roll_rad + 0.9 * kTurn * At(5, t_s), up);
}

double Step(double a, double b, double t) {
  const double x = std::clamp((t - a) / (b - a), 0.0, 1.0);
  return x * x * x * (x * (6.0 * x - 15.0) + 10.0);
}

Vector3d Mix(const Vector3d& a, const Vector3d& b, double f) {
  return a + f * (b - a);
}

std::function<Rigid3(double)> CarOnPath(
    const std::function<Vector2d(double)>& position) {
  return CarOnPath(position, [](double t_s) { return t_s; });
}

std::function<Rigid3(double)> CarOnPath(
    const std::function<Vector2d(double)>& place,
    const std::function<double(double)>& way) {
  return [place, way](double t_s) {
    constexpr double kStep = 1e-3;
    const double at = way(t_s);
    const Vector2d along = place(at + kStep) - place(at - kStep);
    const Vector2d p = place(at);
    return CarParked({p.x(), p.y(), 0.0}, std::atan2(along.y(), along.x()));
  };
}

Rigid3 CarParked(const Vector3d& at, double heading_rad) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(heading_rad, Vector3d::UnitZ())),
          at};
}

}  // namespace groundlock::simulator
