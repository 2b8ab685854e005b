// SPDX-License-Identifier: Apache-2.0
#include "server/localization/camera_state.h"

#include <algorithm>

#include "server/localization/window/seconds.h"

namespace groundlock::localization {

void CameraStateMachine::Succeed(std::chrono::nanoseconds time,
                                 const geometry::Rigid3& world_from_camera,
                                 const geometry::Matrix6d& covariance,
                                 double depth,
                                 LocalizationResult& result,
                                 bool by_map) {
  Note(time, world_from_camera, covariance, depth);
  result.state = by_map ? CameraState::kTracked : CameraState::kOdometry;
  result.world_from_camera = world_from_camera;
  result.covariance = covariance;
  result.reset_count = reset_count_;
}

void CameraStateMachine::Verify(std::chrono::nanoseconds time,
                                const geometry::Rigid3& world_from_camera,
                                const geometry::Matrix6d& covariance,
                                double depth) {
  if (last_ && time <= last_->time) return;
  Note(time, world_from_camera, covariance, depth);
}

void CameraStateMachine::Note(std::chrono::nanoseconds time,
                              const geometry::Rigid3& world_from_camera,
                              const geometry::Matrix6d& covariance,
                              double depth) {
  Success success{.time = time,
                  .world_from_camera = world_from_camera,
                  .covariance = covariance,
                  .speed_per_s = hold_.speed_depths_per_s * depth,
                  .turn_rate_rad_per_s = hold_.turn_rate_rad_per_s};
  if (!last_ || time - last_->time > lost_after_) ++reset_count_;
  if (last_ && time > last_->time && time - last_->time <= lost_after_) {
    const double dt_s = Seconds(time - last_->time);
    const geometry::Rigid3& before = last_->world_from_camera;
    success.speed_per_s = std::max(
        success.speed_per_s,
        (world_from_camera.translation - before.translation).norm() / dt_s);
    success.turn_rate_rad_per_s =
        std::max(success.turn_rate_rad_per_s,
                 geometry::AngleBetween_rad(world_from_camera.rotation,
                                            before.rotation) /
                     dt_s);
  }
  last_ = success;
}

void CameraStateMachine::Fail(std::chrono::nanoseconds time,
                              const std::optional<PoseEstimate>& bridged,
                              LocalizationResult& result) const {
  result.reset_count = reset_count_;
  result.world_from_camera.reset();
  result.covariance.setZero();
  if (!last_) {
    result.state = CameraState::kInitializing;
    return;
  }
  const std::chrono::nanoseconds age =
      std::max(time - last_->time, std::chrono::nanoseconds{0});
  if (age > lost_after_) {
    result.state = CameraState::kLost;
    return;
  }
  result.state = CameraState::kHeld;
  if (bridged) {
    result.world_from_camera = bridged->world_from_camera;
    result.covariance = bridged->covariance;
    return;
  }
  result.world_from_camera = last_->world_from_camera;
  const double position_sigma = last_->speed_per_s * Seconds(age);
  const double rotation_sigma = last_->turn_rate_rad_per_s * Seconds(age);
  result.covariance = last_->covariance;
  result.covariance.diagonal().head<3>().array() +=
      position_sigma * position_sigma;
  result.covariance.diagonal().tail<3>().array() +=
      rotation_sigma * rotation_sigma;
}

}  // namespace groundlock::localization
