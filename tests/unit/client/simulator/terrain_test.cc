// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/terrain.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "client/simulator/internal/sequences.h"

namespace groundlock::simulator {
namespace {

constexpr double kHalfSide_m = 13.0;

TEST(Terrain, LevelGroundLeavesEverythingWhereItIs) {
  const Terrain level;
  EXPECT_TRUE(level.is_level());
  EXPECT_EQ(level.HeightAt(3.0, -4.0), 0.0);
  EXPECT_EQ(level.NormalAt(3.0, -4.0), Eigen::Vector3d::UnitZ());
  const geometry::Rigid3 pose{
      Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ())),
      {1.0, 2.0, 0.0}};
  EXPECT_EQ(level.Stand(pose).translation, pose.translation);
  EXPECT_EQ(level.Stand(pose).rotation.coeffs(), pose.rotation.coeffs());
}

TEST(Terrain, HillsAreAsSteepAsStatedAndTheirNormalsFit) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const Terrain hills = Terrain::Hills(seed, kHalfSide_m);
    EXPECT_FALSE(hills.is_level());
    double steepest_rad = 0.0;
    for (double y = -kHalfSide_m; y <= kHalfSide_m; y += 0.5) {
      for (double x = -kHalfSide_m; x <= kHalfSide_m; x += 0.5) {
        const Eigen::Vector3d normal = hills.NormalAt(x, y);
        steepest_rad = std::max(steepest_rad, std::acos(normal.z()));
        EXPECT_LE(std::abs(hills.HeightAt(x, y)), hills.MaxHeight());
        constexpr double kStep_m = 1e-4;
        const Eigen::Vector3d across(
            2.0 * kStep_m,
            0.0,
            hills.HeightAt(x + kStep_m, y) - hills.HeightAt(x - kStep_m, y));
        EXPECT_NEAR(normal.dot(across) / kStep_m, 0.0, 1e-6);
      }
    }
    EXPECT_NEAR(steepest_rad * 180.0 / M_PI, 20.0, 1.0);
  }
}

TEST(Terrain, CarsStandOnItAndCamerasAreCarriedOverIt) {
  const Terrain hills = Terrain::Hills(4, kHalfSide_m);
  for (const std::string& name : YardSequenceNames()) {
    const auto level = YardDrive(name, Terrain(), 1);
    const auto drive = YardDrive(name, hills, 1);
    ASSERT_EQ(level.has_value(), drive.has_value());
    if (!drive) continue;
    for (double t_s = 0.0; t_s < drive->duration_s; t_s += 0.5) {
      const geometry::Rigid3 car = drive->world_from_car(t_s);
      const Eigen::Vector3d& p = car.translation;
      EXPECT_NEAR(p.z(), hills.HeightAt(p.x(), p.y()), 1e-9) << name;
      EXPECT_NEAR((car.rotation * Eigen::Vector3d::UnitZ() -
                   hills.NormalAt(p.x(), p.y()))
                      .norm(),
                  0.0,
                  1e-9);
      const Eigen::Vector3d eye = drive->world_from_camera(t_s).translation;
      const Eigen::Vector3d level_eye =
          level->world_from_camera(t_s).translation;
      // The hand's own sway is some centimetres.
      EXPECT_NEAR(
          eye.z() - hills.HeightAt(eye.x(), eye.y()), level_eye.z(), 0.1);
    }
  }
}

}  // namespace
}  // namespace groundlock::simulator
