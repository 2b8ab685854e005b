// SPDX-License-Identifier: Apache-2.0
#include "server/localization/camera_state.h"

#include <gtest/gtest.h>

namespace groundlock::localization {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class CameraStateTest : public testing::Test {
 protected:
  LocalizationResult Succeed(std::chrono::nanoseconds time, double x_m) {
    LocalizationResult result;
    const geometry::Rigid3 pose{Eigen::Quaterniond::Identity(), {x_m, 0, 0}};
    machine_.Succeed(time, pose, covariance_, 10.0, result);
    return result;
  }
  LocalizationResult Fail(std::chrono::nanoseconds time) {
    LocalizationResult result;
    machine_.Fail(time, bridged_, result);
    return result;
  }

  geometry::Matrix6d covariance_ = 1e-4 * geometry::Matrix6d::Identity();
  std::optional<PoseEstimate> bridged_;
  CameraStateMachine machine_{seconds(2), {0.1, 0.5}};
};

TEST_F(CameraStateTest, InitializingHasNoPose) {
  for (const auto time : {seconds(0), seconds(1), seconds(100)}) {
    const LocalizationResult result = Fail(time);
    EXPECT_EQ(result.state, CameraState::kInitializing);
    EXPECT_FALSE(result.world_from_camera);
  }
}

TEST_F(CameraStateTest, HeldKeepsThePoseAndGrowsUncertain) {
  EXPECT_EQ(Succeed(seconds(1), 3.0).state, CameraState::kTracked);
  const LocalizationResult soon = Fail(milliseconds(1'100));
  EXPECT_EQ(soon.state, CameraState::kHeld);
  ASSERT_TRUE(soon.world_from_camera);
  EXPECT_EQ(soon.world_from_camera->translation.x(), 3.0);
  // 0.1 depths of 10 m a second, 0.5 rad/s, for 0.1 s.
  EXPECT_NEAR(soon.covariance(0, 0), 1e-4 + 0.1 * 0.1, 1e-12);
  EXPECT_NEAR(soon.covariance(5, 5), 1e-4 + 0.05 * 0.05, 1e-12);
  EXPECT_GT(Fail(seconds(2)).covariance(0, 0), soon.covariance(0, 0));
}

TEST_F(CameraStateTest, FastCamerasGrowUncertainFaster) {
  Succeed(seconds(0), 0.0);
  Succeed(seconds(1), 5.0);  // 5 m/s
  EXPECT_NEAR(Fail(seconds(2)).covariance(0, 0), 1e-4 + 25.0, 1e-9);
}

TEST_F(CameraStateTest, LostAfterTheTimeGivenAndBack) {
  Succeed(seconds(10), 1.0);
  EXPECT_EQ(Fail(seconds(12)).state, CameraState::kHeld);
  const LocalizationResult lost = Fail(seconds(12) + milliseconds(1));
  EXPECT_EQ(lost.state, CameraState::kLost);
  EXPECT_FALSE(lost.world_from_camera);
  EXPECT_EQ(machine_.last()->world_from_camera.translation.x(), 1.0);
  EXPECT_EQ(Succeed(seconds(20), 2.0).state, CameraState::kTracked);
  EXPECT_EQ(Fail(seconds(21)).state, CameraState::kHeld);
}

TEST_F(CameraStateTest, ABridgedPoseIsHeldAsItIs) {
  Succeed(seconds(1), 3.0);
  bridged_.emplace();
  bridged_->world_from_camera.translation.x() = 4.0;
  bridged_->covariance = 0.25 * geometry::Matrix6d::Identity();
  const LocalizationResult held = Fail(seconds(2));
  EXPECT_EQ(held.state, CameraState::kHeld);
  EXPECT_EQ(held.world_from_camera->translation.x(), 4.0);
  EXPECT_EQ(held.covariance(0, 0), 0.25);
  // Not for longer than a verified one.
  EXPECT_EQ(Fail(seconds(4)).state, CameraState::kLost);
}

TEST_F(CameraStateTest, CountsWhatDoesNotContinue) {
  EXPECT_EQ(Fail(seconds(0)).reset_count, 0U);
  EXPECT_EQ(Succeed(seconds(1), 0.0).reset_count, 1U);
  EXPECT_EQ(Succeed(seconds(2), 0.0).reset_count, 1U);
  EXPECT_EQ(Fail(seconds(3)).reset_count, 1U);
  EXPECT_EQ(Succeed(seconds(4), 0.0).reset_count, 1U);
  machine_.NoteJump();
  EXPECT_EQ(Succeed(seconds(5), 9.0).reset_count, 2U);
  EXPECT_EQ(Succeed(seconds(8), 0.0).reset_count, 3U);  // it was lost
  machine_.Reset();
  EXPECT_EQ(Succeed(seconds(9), 0.0).reset_count, 4U);
}

TEST_F(CameraStateTest, ResetForgets) {
  Succeed(seconds(1), 1.0);
  machine_.Reset();
  EXPECT_EQ(Fail(seconds(1)).state, CameraState::kInitializing);
  EXPECT_FALSE(machine_.last());
}

}  // namespace
}  // namespace groundlock::localization
