// SPDX-License-Identifier: Apache-2.0
// A target's silhouette from frame to frame: when it is measured, which one is
// believed, and what the body learns of it.
#ifndef GROUNDLOCK_SERVER_TRACKING_TARGET_SILHOUETTE_H_
#define GROUNDLOCK_SERVER_TRACKING_TARGET_SILHOUETTE_H_

#include <Eigen/Core>
#include <chrono>
#include <functional>
#include <optional>

#include "map_store/geometry/box.h"
#include "server/ground/box_fit.h"
#include "server/image/frame.h"
#include "server/tracking/camera_view.h"
#include "server/tracking/ground_target.h"
#include "server/tracking/moving_silhouette.h"
#include "server/tracking/recent_outlines.h"

namespace groundlock::tracking {

// Pixels of whole images; times are capture times. Not thread-safe.
class TargetSilhouette {
 public:
  // A frame begins: of it nothing is measured yet.
  void Begin();
  // A silhouette costs more than a look: was the last one long enough ago?
  bool IsDue(std::chrono::nanoseconds time) const;
  // Measures that of a body which goes along the ground; once in a frame.
  //   is_shared  may another target be in that box, too? Two that touch have
  //     one silhouette.
  void Measure(const image::Frame& frame,
               const CameraView& camera,
               const GroundTarget& body,
               const std::function<bool(const geometry::Box2&)>& is_shared);
  // In this frame; nullopt: not measured, or not where the target is followed.
  const std::optional<ground::SeenOutline>& seen() const { return seen_; }
  // In this frame, beside where the target is followed; nullopt: it is not, or
  // has not stood there often enough in a row to be believed.
  std::optional<ground::SeenOutline> Beside() const;
  // The target is not followed there any more.
  void ForgetBeside() { times_beside_ = 0; }

  // The body takes the place and the size that this silhouette and those before
  // it tell. The point that the 2D tracker follows is at the middle of
  // `box_px`.
  //   by_body  the middle of the body's outline, as its points have it, and not
  //     where the 2D tracker found the target.
  // Returns as GroundTarget::SeeSilhouette.
  Eigen::Vector3d Teach(const CameraView& camera,
                        const geometry::Box2& box_px,
                        bool by_body,
                        std::chrono::nanoseconds time,
                        GroundTarget& body);
  // It is not known where the followed point was before.
  void ForgetBefore() { recent_.Forget(); }

  // The target is in that frame, at `outline_px`.
  void Keep(const image::Frame& frame,
            const CameraView& camera,
            const geometry::Box2& outline_px,
            const geometry::Box3& body_world);
  // It is not: this is how the ground looks without it, about there.
  void KeepWithout(const image::Frame& frame,
                   const CameraView& camera,
                   const geometry::Box2& about_px) {
    pictures_.KeepWithout(frame, camera, about_px);
  }

 private:
  friend struct StateFields;

  MovingSilhouette pictures_;
  // Of one frame: not carried.
  std::optional<ground::SeenOutline> seen_;
  std::optional<ground::SeenOutline> beside_;
  int times_beside_ = 0;  // in a row so far
  std::chrono::nanoseconds asked_{0};
  std::chrono::nanoseconds taught_{0};
  RecentOutlines recent_;
  bool by_body_ = false;  // those
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TARGET_SILHOUETTE_H_
