// SPDX-License-Identifier: Apache-2.0
// How the camera moves between frames: a Kalman filter with constant velocity
// and white acceleration. Where the landmarks in view leave a direction weakly
// determined (a far facade, a narrow strip of it), the camera's inertia holds
// it.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_MOTION_FILTER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_MOTION_FILTER_H_

#include <Eigen/Core>
#include <chrono>

#include "server/localization/pose_estimate.h"

namespace groundlock::localization {

struct CameraMotionOptions {
  // Standard deviation of the acceleration of a camera in the hand, on a drone
  // or a vehicle. Unit of the map per s^2.
  double acceleration_s2 = 4.0;
  double angular_acceleration_rad_s2 = 25.0;
  double initial_velocity_s = 1.0;
  double initial_angular_velocity_rad_s = 1.0;
  // Longer steps say nothing about the motion before.
  double max_step_s = 0.25;
  // A measurement that contradicts the prediction beyond this starts anew.
  double max_mahalanobis_squared = 60.0;
};

// Not thread-safe. Poses and covariances are relative to whatever reference the
// measurements share: their common error is not part of the state.
class CameraMotionFilter {
 public:
  using Matrix12d = Eigen::Matrix<double, 12, 12>;

  explicit CameraMotionFilter(const CameraMotionOptions& options)
      : options_(options) {}

  // At rest, as far as is known.
  void Start(std::chrono::nanoseconds time, const PoseEstimate& pose);
  // Where the camera is at `time`; the state stays. Steps beyond max_step_s
  // are cut off there: a hand does not go on turning.
  geometry::Rigid3 PredictPose(std::chrono::nanoseconds time) const;
  // Moves to `time` and takes in the pose measured there.
  PoseEstimate Update(std::chrono::nanoseconds time,
                      const PoseEstimate& measured);
  // The reference has moved: world poses are now `correction` times as before.
  void Shift(const geometry::Rigid3& correction);
  // The pose now is the reference itself: exact, while the velocity is kept.
  void MakeReference();

  std::chrono::nanoseconds time() const { return time_; }

 private:
  CameraMotionOptions options_;
  std::chrono::nanoseconds time_{0};
  geometry::Rigid3 world_from_camera_;
  Eigen::Vector3d velocity_world_s_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity_world_rad_s_ = Eigen::Vector3d::Zero();
  Matrix12d covariance_ = Matrix12d::Zero();  // dp, dtheta, dv, domega
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_MOTION_FILTER_H_
