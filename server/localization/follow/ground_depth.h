// SPDX-License-Identifier: Apache-2.0
// How far away the map's ground is where a pixel sees it. Nothing lies beyond
// it, and most of what lies below the horizon lies on it: what a camera sees
// that turns on the spot, or where the map has just ended, has a depth before
// any parallax shows it.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_GROUND_DEPTH_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_GROUND_DEPTH_H_

#include <Eigen/Core>
#include <optional>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"

namespace groundlock::localization {

struct GroundDepth {
  double depth = 1.0;           // along the optical axis, unit of the map
  double relative_sigma = 0.0;  // of its inverse, if it is the ground's
};

// nullopt above the ground's horizon, below the ground, and where nobody knows
// it. Beyond a relief that is known the ground goes on as a plane, which may
// be far off. Thread-safe.
std::optional<GroundDepth> DepthOfGround(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const Eigen::Vector2d& pixel_px);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_GROUND_DEPTH_H_
