// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/sequences.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace groundlock::simulator {
namespace {

// Shown again and again, the demo's drive must not jump: a lap later, and so at
// its end, the camera and both cars are where they were.
TEST(Sequences, LapsEndWhereTheyBegan) {
  for (const std::uint64_t seed : {1U, 2U}) {
    const auto drive = YardDrive("laps", Terrain(), seed);
    ASSERT_TRUE(drive.has_value());
    ASSERT_EQ(drive->world_from_other_cars.size(), 1U);
    EXPECT_NEAR(drive->duration_s, 16.0, 1e-9);
    for (const auto& pose_at : {drive->world_from_camera,
                                drive->world_from_car,
                                drive->world_from_other_cars[0]}) {
      for (const double t_s : {0.0, 0.02, 3.0, 5.5, 12.0}) {
        const geometry::Rigid3 before = pose_at(t_s);
        const geometry::Rigid3 after = pose_at(t_s + drive->duration_s);
        EXPECT_LT((before.translation - after.translation).norm(), 1e-6) << t_s;
        EXPECT_LT(before.rotation.angularDistance(after.rotation), 1e-6) << t_s;
      }
      // And it moves: half a lap later it is elsewhere.
      const geometry::Rigid3 half = pose_at(0.5 * drive->duration_s);
      EXPECT_GT((pose_at(0.0).translation - half.translation).norm(), 1e-3);
    }
  }
}

// What the scene is for: a camera that rolls, and views from above.
TEST(Sequences, ADroneRollsAndLooksDown) {
  const auto rolls_deg = [](const geometry::Rigid3& world_from_camera) {
    const Eigen::Vector3d up_camera =
        world_from_camera.rotation.inverse() * Eigen::Vector3d::UnitZ();
    return std::abs(std::atan2(up_camera.x(), -up_camera.y())) * 180.0 / M_PI;
  };
  const auto down = [](const geometry::Rigid3& world_from_camera) {
    return -(world_from_camera.rotation * Eigen::Vector3d::UnitZ()).z();
  };
  const auto bank = AerialDrive("bank", Terrain(), 1);
  const auto overhead = AerialDrive("overhead", Terrain(), 1);
  const auto flyover = AerialDrive("flyover", Terrain(), 1);
  ASSERT_TRUE(bank && overhead && flyover);
  EXPECT_FALSE(AerialDrive("mapping", Terrain(), 1));
  double most_rolled_deg = 0.0;
  double steepest = 0.0;
  for (double t_s = 0.0; t_s < bank->duration_s; t_s += 0.1) {
    most_rolled_deg =
        std::max(most_rolled_deg, rolls_deg(bank->world_from_camera(t_s)));
    steepest = std::max(steepest, down(flyover->world_from_camera(t_s)));
    EXPECT_GT(down(overhead->world_from_camera(t_s)), 0.999);
  }
  EXPECT_NEAR(most_rolled_deg, 32.0, 2.0);
  EXPECT_GT(steepest, 0.95);
  for (const geometry::Rigid3& view : AerialMappingViews(Terrain(), 1)) {
    EXPECT_TRUE(view.rotation.coeffs().allFinite());
    EXPECT_GT(view.translation.z(), 3.0);
  }
}

}  // namespace
}  // namespace groundlock::simulator
