// SPDX-License-Identifier: Apache-2.0
// What camera paths and drives are made of.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_CAMERA_PATHS_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_CAMERA_PATHS_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>

#include "client/simulator/internal/terrain.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

// x right, y down, z towards `target`, with `up` upwards in the image; roll
// turns the camera clockwise.
geometry::Rigid3 LookAt(const Eigen::Vector3d& eye,
                        const Eigen::Vector3d& target,
                        double roll_rad,
                        const Eigen::Vector3d& up = Eigen::Vector3d::UnitZ());

// A hand: sums of slow sines with frequencies and phases drawn once.
class Shake {
 public:
  // terrain: what whoever holds it, and what it is aimed at, stand on.
  // period_s: after which the hand does the same again; 0 = never.
  Shake(const Terrain& terrain, std::uint64_t seed, double period_s = 0.0);

  // About [-1, 1]; axis 0-5.
  double At(int axis, double t_s) const;
  // Points are given over level ground.
  geometry::Rigid3 Apply(
      const Eigen::Vector3d& level_eye,
      const Eigen::Vector3d& level_target,
      double t_s,
      double roll_rad = 0.0,
      const Eigen::Vector3d& up = Eigen::Vector3d::UnitZ()) const;

 private:
  struct Wave {
    double rate = 0.0;
    double phase = 0.0;
    double amplitude = 0.0;
  };
  struct Axis {
    std::array<Wave, 4> waves;
  };
  Terrain terrain_;
  std::array<Axis, 6> axes_;
};

// 0 before a, 1 after b, smooth between.
double Step(double a, double b, double t);
Eigen::Vector3d Mix(const Eigen::Vector3d& a,
                    const Eigen::Vector3d& b,
                    double f);
// world_from_car of a car on level ground that heads along its path.
std::function<geometry::Rigid3(double)> CarOnPath(
    const std::function<Eigen::Vector2d(double)>& position);
// The same of a car that has gone as far as `way` says along `place`: it keeps
// its heading where it stands, and backs where `way` falls.
std::function<geometry::Rigid3(double)> CarOnPath(
    const std::function<Eigen::Vector2d(double way)>& place,
    const std::function<double(double t_s)>& way);
geometry::Rigid3 CarParked(const Eigen::Vector3d& at, double heading_rad);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_CAMERA_PATHS_H_
