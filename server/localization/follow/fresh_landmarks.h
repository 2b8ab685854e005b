// SPDX-License-Identifier: Apache-2.0
// Landmarks that came into view, by projection.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRESH_LANDMARKS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRESH_LANDMARKS_H_

#include <span>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/localization/follow/key_frame_follower.h"

namespace groundlock::localization {

// Up to `max_landmarks`, spread over the image, that the pose projects outside
// `masks_px`, that a nearby map view saw from a similar place, and that are not
// among `known`. None is anchored. Thread-safe.
std::vector<FollowedLandmark> ProjectFreshLandmarks(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    std::span<const geometry::Box2> masks_px,
    std::span<const FollowedLandmark> known,
    int min_landmark_views,
    int max_landmarks);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_FRESH_LANDMARKS_H_
