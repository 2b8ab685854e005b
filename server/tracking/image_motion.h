// SPDX-License-Identifier: Apache-2.0
// How a target moves in the image where nothing is known of the ground.
#ifndef GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_
#define GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_

#include <Eigen/Core>
#include <chrono>

#include "map_store/geometry/box.h"

namespace groundlock::tracking {

// Constant velocity, as well known as it has predicted so far: a camera that
// shakes makes it say little, a steady one much. Pixels. Not thread-safe.
class ImageMotion {
 public:
  // Starts at rest, uncertain by half the box's side.
  void Restart(const geometry::Box2& box_px, std::chrono::nanoseconds time);
  // Where it was seen, later than before.
  void Update(const geometry::Box2& box_px, std::chrono::nanoseconds time);

  struct Prediction {
    Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
    Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
  };
  Prediction Predict(std::chrono::nanoseconds time) const;

 private:
  Eigen::Vector2d center_px_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_px_s_ = Eigen::Vector2d::Zero();
  double side_px_ = 1.0;
  double step_s_ = 0.04;         // between sightings
  double innovation_px2_ = 1.0;  // mean square of one axis, per step
  std::chrono::nanoseconds time_{0};
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_
