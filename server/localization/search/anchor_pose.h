// SPDX-License-Identifier: Apache-2.0
// The pose of a frame whose landmarks were found by descriptors, with every
// landmark's own uncertainty: what is random in it, and what comes back in the
// next frame because the same landmarks are seen again.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_POSE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_POSE_H_

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"
#include "server/localization/solvers/robust_pose.h"
#include "server/localization/window/pose_filter.h"

namespace groundlock::localization {

struct AnchorPose {
  MapMeasurement measured;  // `shared` is 0: see SharedLandmarks
  RobustPose pose;          // is_inlier: per match
};

// Refines `initial` on the matches, each weighted by its feature's and its
// landmark's variance. nullopt as RefinePoseRobustly. Thread-safe.
std::optional<AnchorPose> RefineAnchorPose(
    const map::Map& map,
    const geometry::CameraModel& camera,
    std::span<const LandmarkMatch> matches,
    const geometry::Rigid3& initial_world_from_camera);

// Share of the larger of two sets of landmarks, each sorted, that is in both.
double SharedLandmarks(std::span<const std::uint32_t> a,
                       std::span<const std::uint32_t> b);

// The landmarks of `matches`, sorted.
std::vector<std::uint32_t> LandmarksOf(std::span<const LandmarkMatch> matches);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_POSE_H_
