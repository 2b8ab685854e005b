// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/terrain.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace groundlock::simulator {

namespace {
constexpr double kSteepest = 0.36397;  // tan 20 degrees
constexpr double kWaveLength_m = 14.0;
}  // namespace

Terrain Terrain::Hills(std::uint64_t seed, double half_side_m) {
  std::mt19937_64 random(seed);
  // Not std::uniform_real_distribution: its values depend on the library.
  const auto unit = [&] {
    return static_cast<double>(random() >> 11U) * 0x1.0p-53;
  };
  Terrain terrain;
  const double first_rad = 2 * std::numbers::pi * unit();
  for (int i = 0; i < 3; ++i) {
    const double angle =
        first_rad + i * std::numbers::pi / 3 + 0.4 * (unit() - 0.5);
    const double length_m = kWaveLength_m * (0.8 + 0.4 * unit());
    terrain.waves_.push_back(
        {2 * std::numbers::pi / length_m *
             Eigen::Vector2d(std::cos(angle), std::sin(angle)),
         2 * std::numbers::pi * unit(),
         0.6 + 0.4 * unit()});
  }
  constexpr int kSteps = 200;
  double steepest = 0.0;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j <= kSteps; ++j) {
      const Eigen::Vector2d at =
          half_side_m *
          Eigen::Vector2d(2.0 * i / kSteps - 1.0, 2.0 * j / kSteps - 1.0);
      steepest = std::max(steepest, terrain.SlopeAt(at.x(), at.y()).norm());
    }
  }
  for (Wave& wave : terrain.waves_) wave.amplitude_m *= kSteepest / steepest;
  return terrain;
}

double Terrain::HeightAt(double x, double y) const {
  double height = 0.0;
  for (const Wave& wave : waves_) {
    height += wave.amplitude_m *
              std::sin(wave.rate.dot(Eigen::Vector2d(x, y)) + wave.phase);
  }
  return height;
}

Eigen::Vector2d Terrain::SlopeAt(double x, double y) const {
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();
  for (const Wave& wave : waves_) {
    slope += wave.amplitude_m *
             std::cos(wave.rate.dot(Eigen::Vector2d(x, y)) + wave.phase) *
             wave.rate;
  }
  return slope;
}

Eigen::Vector3d Terrain::NormalAt(double x, double y) const {
  const Eigen::Vector2d slope = SlopeAt(x, y);
  return Eigen::Vector3d(-slope.x(), -slope.y(), 1.0).normalized();
}

double Terrain::MaxHeight() const {
  double height = 0.0;
  for (const Wave& wave : waves_) height += wave.amplitude_m;
  return height;
}

Eigen::Vector3d Terrain::Lift(const Eigen::Vector3d& p_world) const {
  return p_world +
         HeightAt(p_world.x(), p_world.y()) * Eigen::Vector3d::UnitZ();
}

geometry::Rigid3 Terrain::Stand(const geometry::Rigid3& world_from_body) const {
  if (is_level()) return world_from_body;
  const Eigen::Vector3d& at = world_from_body.translation;
  return {Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(),
                                             NormalAt(at.x(), at.y())) *
              world_from_body.rotation,
          Lift(at)};
}

}  // namespace groundlock::simulator
