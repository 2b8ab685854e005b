// SPDX-License-Identifier: Apache-2.0
// The yard's left half from a drone: cameras that roll, and views from above.
#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "client/simulator/internal/camera_paths.h"
#include "client/simulator/internal/sequences.h"
#include "map_store/base/mix_seed.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Rigid3;

constexpr double kLane_m = -6.5;  // x of the free lane along the wall

// The drone follows a car that drives bends, and banks by up to 32 degrees.
Drive Bank(const Shake& shake) {
  constexpr double kDuration_s = 8.0;
  constexpr double kBank_rad = 0.56;
  const auto car = [](double t) {
    return Vector2d(kLane_m - 0.3 + 0.7 * std::sin(0.9 * t), -6.4 + 1.6 * t);
  };
  const auto camera = [shake, car](double t) {
    const Vector2d p = car(t);
    const Vector3d eye(kLane_m + 0.3 * (p.x() - kLane_m), p.y() - 5.0, 3.5);
    return shake.Apply(eye,
                       {0.5 * (p.x() + kLane_m), p.y() + 0.6, 0.2},
                       t,
                       kBank_rad * std::sin(1.3 * t));
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// Straight from above: the car drives up the lane, turns and comes back; the
// drone drifts along and turns by 50 degrees.
Drive Overhead(const Shake& shake) {
  constexpr double kDuration_s = 11.0;
  constexpr double kSpeed_m_s = 1.3;
  constexpr double kStraight_m = 6.0;
  constexpr double kRound_m = 1.2;  // radius
  const Vector2d start(kLane_m - 1.4, -5.0);
  const auto car = [=](double t) -> Vector2d {
    const double way_m = kSpeed_m_s * t;
    if (way_m < kStraight_m) return start + Vector2d(0.0, way_m);
    const double turn_m = std::numbers::pi * kRound_m;
    const Vector2d center = start + Vector2d(kRound_m, kStraight_m);
    if (way_m < kStraight_m + turn_m) {
      const double angle = std::numbers::pi - (way_m - kStraight_m) / kRound_m;
      return center + kRound_m * Vector2d(std::cos(angle), std::sin(angle));
    }
    return center + Vector2d(kRound_m, -(way_m - kStraight_m - turn_m));
  };
  const auto camera = [shake, car](double t) {
    constexpr double kHeight_m = 8.0;
    const double yaw_rad = 0.87 * Step(1.0, kDuration_s, t);
    const Vector2d p = car(t);
    const Vector3d below(kLane_m, -2.0 + 0.5 * (p.y() + 2.0), 0.0);
    return shake.Apply(below + kHeight_m * Vector3d::UnitZ(),
                       below,
                       t,
                       0.0,
                       {-std::sin(yaw_rad), std::cos(yaw_rad), 0.0});
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// Once around a car that goes on slowly, from 45 degrees above.
Drive Circle(const Shake& shake) {
  constexpr double kDuration_s = 12.0;
  const auto car = [](double t) {
    return Vector2d(kLane_m - 0.5 + 0.8 * std::sin(0.5 * t), -3.2 + 0.5 * t);
  };
  const auto camera = [shake, car](double t) {
    constexpr double kRadius_m = 5.0;
    const double angle =
        -0.5 * std::numbers::pi + 2.0 * std::numbers::pi * t / kDuration_s;
    const Vector2d p = car(t);
    const Vector3d at_car(p.x(), p.y(), 0.2);
    const Vector3d out(std::cos(angle), std::sin(angle), 1.0);
    return shake.Apply(at_car + kRadius_m * out, at_car, t);
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// The drone comes from 10 m away, passes over a parked car and goes on, while
// its camera stays on the car and turns by half a round above it.
Drive Flyover(const Shake& shake) {
  constexpr double kDuration_s = 8.0;
  const Vector3d parked(kLane_m, -1.0, 0.0);
  const auto camera = [shake, parked](double t) {
    const Vector3d eye(parked.x() + 1.3, -11.4 + 2.6 * t, 5.0);
    return shake.Apply(eye, parked + Vector3d(0.0, 0.0, 0.2), t);
  };
  const Rigid3 pose = CarParked(parked, 0.9);
  return {kDuration_s, camera, [pose](double) { return pose; }};
}

}  // namespace

std::vector<std::string> AerialSequenceNames() {
  return {std::string(kMapping), "bank", "overhead", "circle", "flyover"};
}

std::optional<Drive> AerialDrive(std::string_view sequence,
                                 const Terrain& terrain,
                                 std::uint64_t seed) {
  const auto shake = [&](std::uint64_t number) {
    return Shake(terrain, base::MixSeed(seed, number));
  };
  if (sequence == "bank") return Bank(shake(21));
  if (sequence == "overhead") return Overhead(shake(22));
  if (sequence == "circle") return Circle(shake(23));
  if (sequence == "flyover") return Flyover(shake(24));
  return std::nullopt;
}

std::vector<Rigid3> AerialMappingViews(const Terrain& terrain,
                                       std::uint64_t seed) {
  const Shake shake(terrain, base::MixSeed(seed, 20));
  std::vector<Rigid3> views;
  const auto add = [&](const Vector3d& eye,
                       const Vector3d& way,
                       const Vector3d& up = Vector3d::UnitZ()) {
    const double t_s = 0.37 * static_cast<double>(views.size());
    views.push_back(shake.Apply(eye, eye + way, t_s, 0.0, up));
  };
  // As drones survey: lanes at one height, looking down and obliquely along
  // them, there and back, and across.
  for (int lane = 0; lane < 3; ++lane) {
    for (int i = 0; i < 8; ++i) {
      const Vector3d eye(kLane_m + 3.5 * (lane - 1), -11.5 + 3.2 * i, 7.0);
      add(eye, -Vector3d::UnitZ(), Vector3d::UnitY());
      add(eye, {0.0, i % 2 == 0 ? 1.0 : -1.0, -1.1});
      add(eye, {lane == 0 ? 1.0 : -1.0, 0.0, -1.1});
    }
  }
  for (int i = 0; i < 14; ++i) {  // lower, along the lane of the drives
    const double y = -11.5 + 1.6 * i;
    add({kLane_m, y, 3.5}, {0.0, i < 11 ? 1.0 : -1.0, -0.55});
    add({kLane_m + 1.3, y, 5.0},
        Vector3d(kLane_m, -1.0, 0.2) - Vector3d(kLane_m + 1.3, y, 5.0));
  }
  return views;
}

}  // namespace groundlock::simulator
