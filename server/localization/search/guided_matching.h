// SPDX-License-Identifier: Apache-2.0
// Matches a frame's features to the landmarks that a known pose projects near
// them: many more matches than a view-by-view search, at a cost that depends on
// the frame, not on the map.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_GUIDED_MATCHING_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_GUIDED_MATCHING_H_

#include <vector>

#include "map_store/features/sift_features.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"

namespace groundlock::localization {

struct GuidedMatchingOptions {
  double radius_px = 12.0;  // around the projected landmark
  int max_views = 12;       // map views whose landmarks are projected
  int min_landmark_views = 3;
  double ratio_test = 0.85;  // against the second feature within the radius
  // RootSIFT x 512: unrelated descriptors lie at about 500.
  double max_descriptor_distance = 300.0;
};

// The map views that look at what the camera sees: near it and facing the same
// way, nearest first.
std::vector<std::size_t> NearbyViews(const map::Map& map,
                                     const geometry::Rigid3& world_from_camera,
                                     int max_views);

struct GuidedMatch : LandmarkMatch {
  int squared_distance = 0;  // of the descriptors, RootSIFT x 512
};

// The landmarks of those views that lie in the image, and where. Thread-safe.
std::vector<LandmarkMatch> LandmarksInView(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const GuidedMatchingOptions& options);

// One match per landmark and per feature. Thread-safe.
std::vector<GuidedMatch> MatchGuided(const map::Map& map,
                                     const features::SiftFeatures& features,
                                     const geometry::CameraModel& camera,
                                     const geometry::Rigid3& world_from_camera,
                                     const GuidedMatchingOptions& options);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_GUIDED_MATCHING_H_
