// SPDX-License-Identifier: Apache-2.0
// What was there while a target was elsewhere.
#ifndef GROUNDLOCK_SERVER_TRACKING_EARLIER_FRAMES_H_
#define GROUNDLOCK_SERVER_TRACKING_EARLIER_FRAMES_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/frame.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// A few frames in which a target was surely seen. What looks like it, and was
// in them somewhere else than it, is not the target: it was there before.
//
// Pixels of whole images, the first one's centre at (0.5, 0.5). Not
// thread-safe. Holds at most three frames of half a mebipixel, 2 MiB, each.
class EarlierFrames {
 public:
  struct Place {
    const image::Frame* frame;  // a smaller one; lives until the next Keep
    geometry::Box2 box_px;      // in its pixels
  };

  // The target is in that frame, at `box_px`. Kept if the last one that was is
  // old enough.
  void Keep(const image::Frame& frame,
            const CameraView& camera,
            const geometry::Box2& box_px);
  // Where what is at `box_px` now would be in them if it stood still, and was
  // no farther away than `distance` along the ray through the box's middle: it
  // may stand before the ground there. Without places that are out of view, or
  // near the target's.
  std::vector<Place> PlacesOf(const CameraView& camera,
                              const geometry::Box2& box_px,
                              double distance) const;

 private:
  friend struct StateFields;

  struct Earlier {
    image::Frame frame;
    double scale = 1.0;  // its pixels per pixel of the image
    geometry::CameraModel camera;
    geometry::Rigid3 world_from_camera;
    std::uint64_t reset_count = 0;
    geometry::Box2 target_px;  // of the image
  };

  std::deque<Earlier> frames_;  // the oldest first
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_EARLIER_FRAMES_H_
