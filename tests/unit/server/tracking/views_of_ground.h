// SPDX-License-Identifier: Apache-2.0
// A camera of 1280x720 that looks from one place at another.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_VIEWS_OF_GROUND_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_VIEWS_OF_GROUND_H_

#include <Eigen/Geometry>
#include <array>

#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

inline geometry::Rigid3 LookAt(const Eigen::Vector3d& eye,
                               const Eigen::Vector3d& target) {
  const Eigen::Vector3d forward = (target - eye).normalized();
  const Eigen::Vector3d right =
      forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  return {Eigen::Quaterniond(R), eye};
}

inline CameraView ViewFrom(const Eigen::Vector3d& eye,
                           const Eigen::Vector3d& target) {
  constexpr std::array<double, 3> kParams = {900.0, 640.0, 360.0};
  static const geometry::CameraModel lens = *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, kParams);
  CameraView camera;
  camera.view.camera = &lens;
  camera.view.world_from_camera = LookAt(eye, target);
  return camera;
}

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_VIEWS_OF_GROUND_H_
