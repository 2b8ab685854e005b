// SPDX-License-Identifier: Apache-2.0
// Where in the whole map a frame may have been taken: its descriptors looked up
// in the map's index, the matches grouped by place, a pose for each.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_PLACE_SEARCH_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_PLACE_SEARCH_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "map_store/features/sift_features.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"

namespace groundlock::localization {

struct PlaceSearchOptions {
  std::size_t max_places = 4;
  // Poses with fewer are left out: nothing is worth a closer look. Of frames of
  // another place, the 800 strongest features give up to 6, of right ones 43
  // and more; where a target that covers a third of the image has most of these
  // features, 6 to 11 (docs/benchmarks.md).
  std::size_t min_inliers = 7;
  std::uint64_t seed = 0;
};

struct PlacePose {
  geometry::Rigid3 world_from_camera;  // by three points
  std::size_t num_inliers = 0;         // within 6 px
};

// Poses not refined, those of views that are near first and then those of views
// with most matches. Thread-safe; deterministic by seed.
//   is_near  per map view (ViewsNearPrior).
std::vector<PlacePose> FindPlaces(const map::Map& map,
                                  const features::SiftFeatures& features,
                                  const geometry::CameraModel& camera,
                                  const std::vector<bool>& is_near,
                                  const PlaceSearchOptions& options);

// The features of the image that is left for right, in the same order: what
// matches better than the features themselves was seen in a mirror.
//   width_px  of the image.
features::SiftFeatures MirrorFeatures(const features::SiftFeatures& features,
                                      double width_px);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_PLACE_SEARCH_H_
