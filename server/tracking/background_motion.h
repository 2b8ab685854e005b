// SPDX-License-Identifier: Apache-2.0
// How what surrounds a target moves in the image: as corners do, or as the
// ground does under a known camera.
#ifndef GROUNDLOCK_SERVER_TRACKING_BACKGROUND_MOTION_H_
#define GROUNDLOCK_SERVER_TRACKING_BACKGROUND_MOTION_H_

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/frame.h"

namespace groundlock::tracking {

// From pixels of one frame to those of the next.
struct ImageAffinity {
  // A turn and a scale, if all that is known is a similarity.
  Eigen::Matrix2d turn = Eigen::Matrix2d::Identity();
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();

  Eigen::Vector2d operator*(const Eigen::Vector2d& pixel_px) const {
    return turn * pixel_px + shift_px;
  }
  // First `other`, then this.
  ImageAffinity operator*(const ImageAffinity& other) const {
    return {.turn = turn * other.turn, .shift_px = *this * other.shift_px};
  }
  ImageAffinity Inverse() const;
};

// A similarity: corners around the target, followed by Lucas-Kanade from each
// frame to the next; what most of them do is the background's motion (RANSAC).
// A similarity does for what lies about one target: of a plane seen from afar
// it is off by less than a point can be followed. Not thread-safe.
class BackgroundMotion {
 public:
  // From the frame before, if it was given too, about `target_px` there.
  // nullopt: it was not, is of another size, or has too few corners that agree.
  // Keeps the frame's pyramid.
  std::optional<ImageAffinity> Follow(const image::Frame& frame,
                                      const geometry::Box2& target_px);
  // The next frame's motion may be asked of from this one on.
  void Keep(const image::Frame& frame);
  // The next frame's motion is not known from the last one.
  void Forget() { last_pyramid_ = nullptr; }

 private:
  friend struct StateFields;

  std::shared_ptr<const image::LumaPyramid> last_pyramid_;
};

// Where the camera is known and the background is a plane: what lies about
// `target_px` in the frame before goes where the ground under it does, to first
// order (a similarity would be off by a tenth of that).
// nullopt if some of that is not on the plane (beyond the horizon).
// Thread-safe.
std::optional<ImageAffinity> MotionOfPlane(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera_before,
    const geometry::Rigid3& world_from_camera,
    const geometry::Plane& plane_world,
    const geometry::Box2& target_px);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BACKGROUND_MOTION_H_
