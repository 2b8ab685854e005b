// SPDX-License-Identifier: Apache-2.0
// The camera of one frame as targets are told of it.
#ifndef GROUNDLOCK_SERVER_TRACKING_CAMERA_VIEW_H_
#define GROUNDLOCK_SERVER_TRACKING_CAMERA_VIEW_H_

#include <cstdint>
#include <memory>

#include "map_store/geometry/rigid3.h"
#include "server/ground/ground_model.h"
#include "server/ground/ground_surface.h"

namespace groundlock::tracking {

// What is known of the camera in one frame, and of the ground.
struct CameraView {
  ground::GroundView view;
  geometry::Matrix6d pose_covariance = geometry::Matrix6d::Zero();
  bool verified = true;  // false: a held pose
  // Whose reference plane is that of the view; null: that plane.
  std::shared_ptr<const ground::GroundSurface> surface = nullptr;
  bool metric = false;  // lengths are metres
  // Raised where the pose does not continue from the frame before's, as
  // LocalizationResult says.
  std::uint64_t reset_count = 0;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_CAMERA_VIEW_H_
