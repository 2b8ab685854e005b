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

// Four cars that nothing but their ways tells apart: they never touch, begin
// and end to drive smoothly, and stand together for a while.
TEST(Sequences, AQuartetMeetsStandsAndParts) {
  constexpr double kStep_s = 0.02;
  constexpr double kLength_m = 0.9;  // of a car
  const auto drive = YardDrive("quartet", Terrain(), 1);
  ASSERT_TRUE(drive.has_value());
  EXPECT_GE(drive->duration_s, 16.0);
  EXPECT_LE(drive->duration_s, 20.0);
  auto cars = drive->world_from_other_cars;
  cars.insert(cars.begin(), drive->world_from_car);
  ASSERT_EQ(cars.size(), 4U);
  const auto gone_m = [&](const auto& car, double from_s, double to_s) {
    return (car(to_s).translation - car(from_s).translation).norm();
  };
  double stood_s = 0.0;
  for (double t_s = 0.0; t_s < drive->duration_s; t_s += kStep_s) {
    bool all_stand = true;
    for (std::size_t i = 0; i < cars.size(); ++i) {
      const geometry::Rigid3 pose = cars[i](t_s);
      for (std::size_t j = 0; j < i; ++j) {
        EXPECT_GT((pose.translation - cars[j](t_s).translation).norm(),
                  kLength_m + 0.05)
            << i << " and " << j << " at " << t_s << " s";
      }
      // Neither speed nor heading jumps, at a stop neither.
      const double before_m = gone_m(cars[i], t_s - kStep_s, t_s);
      const double after_m = gone_m(cars[i], t_s, t_s + kStep_s);
      EXPECT_LT(std::abs(after_m - before_m), 2.0 * kStep_s * kStep_s);
      EXPECT_LT(pose.rotation.angularDistance(cars[i](t_s + kStep_s).rotation),
                2.5 * kStep_s)
          << i << " at " << t_s << " s";
      all_stand &= after_m < 1e-6;
    }
    if (all_stand && t_s > 1.0) stood_s += kStep_s;
  }
  EXPECT_GE(stood_s, 2.0);
  EXPECT_LE(stood_s, 3.5);
  // One backs: at the end it heads to where it stood.
  const geometry::Rigid3 end = cars[3](drive->duration_s);
  const geometry::Rigid3 stand = cars[3](9.5);
  EXPECT_GT((end.rotation * Eigen::Vector3d::UnitX())
                .dot((stand.translation - end.translation).normalized()),
            0.7);
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
