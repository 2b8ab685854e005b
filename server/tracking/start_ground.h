// SPDX-License-Identifier: Apache-2.0
// On which ground a target stands that was just marked.
#ifndef GROUNDLOCK_SERVER_TRACKING_START_GROUND_H_
#define GROUNDLOCK_SERVER_TRACKING_START_GROUND_H_

#include "map_store/geometry/box.h"
#include "map_store/geometry/plane.h"
#include "server/ground/ground_surface.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

struct StartGround {
  geometry::Plane plane_world;  // normal up
  bool is_crest = false;        // which hides the target's feet
  double rise_m = 0.0;  // by which that is higher than the surface has it
};

// The ground under the middle of the box's lower edge, or the reference plane
// where it is not known. What a crest hides the feet of meets it with its lower
// edge, wherever it stands behind: the crest's level, then. Thread-safe.
StartGround StartGroundOf(const CameraView& camera,
                          const ground::GroundSurface& surface,
                          const geometry::Box2& box_px);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_START_GROUND_H_
