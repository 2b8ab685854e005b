// SPDX-License-Identifier: Apache-2.0
// How what surrounds a target moves into each frame, by what tells it best.
#ifndef GROUNDLOCK_SERVER_TRACKING_TARGET_BACKGROUND_H_
#define GROUNDLOCK_SERVER_TRACKING_TARGET_BACKGROUND_H_

#include <cstdint>
#include <optional>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/frame.h"
#include "server/tracking/background_motion.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// As the camera went over the ground if its poses are known in this frame and
// the one before, else as the image says. Every frame is given, to one of the
// three. Not thread-safe.
class TargetBackground {
 public:
  // The first frame: nothing has moved into it. `camera` null: not known.
  void Start(const image::Frame& frame, const CameraView* camera);
  // The next one.
  //   ground_world  touches the ground where the target is; null: not known.
  //   target_px  in the frame before.
  void Follow(const image::Frame& frame,
              const CameraView* camera,
              const geometry::Plane* ground_world,
              const geometry::Box2& target_px);
  // Nobody asks how it moves into this frame.
  void Skip(const CameraView* camera);

  // From the frame before; nullopt: nothing tells it, or nobody asked.
  const std::optional<ImageAffinity>& motion() const { return motion_; }
  // By the camera's poses, so that it still holds after seconds.
  bool is_known() const { return is_known_; }

 private:
  friend struct StateFields;

  struct View {
    geometry::CameraModel camera;
    geometry::Rigid3 world_from_camera;
    std::uint64_t reset_count = 0;
  };
  static std::optional<View> ViewOf(const CameraView* camera);

  BackgroundMotion image_;
  std::optional<View> last_view_;  // nullopt: that frame had no verified pose
  std::optional<ImageAffinity> motion_;
  bool is_known_ = false;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TARGET_BACKGROUND_H_
