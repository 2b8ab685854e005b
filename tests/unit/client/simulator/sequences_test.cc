// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/sequences.h"

#include <gtest/gtest.h>

namespace groundlock::simulator {
namespace {

// Shown again and again, the demo's drive must not jump: a lap later, and so at
// its end, the camera and both cars are where they were.
TEST(Sequences, LapsEndWhereTheyBegan) {
  for (const std::uint64_t seed : {1U, 2U}) {
    const auto drive = YardDrive("laps", Terrain(), seed);
    ASSERT_TRUE(drive.has_value());
    ASSERT_TRUE(drive->world_from_other_car != nullptr);
    EXPECT_NEAR(drive->duration_s, 16.0, 1e-9);
    for (const auto& pose_at : {drive->world_from_camera,
                                drive->world_from_car,
                                drive->world_from_other_car}) {
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

}  // namespace
}  // namespace groundlock::simulator
