// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_FILTER_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_FILTER_H_

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// Keeps landmarks `is_kept` (one per landmark) and their observations, and
// renumbers them in their order. Views stay, even without observations.
void KeepLandmarks(const std::vector<bool>& is_kept, map::MapData* data);

// In how many different views each landmark is seen.
std::vector<int> CountViews(const map::MapData& data);

// Drops observations that reproject more than max_error_px away or lie behind
// their camera, second observations of a landmark in the same view, then
// landmarks with fewer than min_views views. `data` must be valid.
void FilterMap(int min_views, double max_error_px, map::MapData* data);

// Two views that see the same, as their geometry has shown.
struct VerifiedPair {
  std::string first;  // names of the views
  std::string second;
  int num_inliers = 0;
};

// Takes out views that the model has put in the wrong place, which happens
// where two places look alike: a view that shares next to no landmarks with
// those that it was verified with best. Returns their names.
std::vector<std::string> DropMisplacedViews(std::span<const VerifiedPair> pairs,
                                            map::MapData* data);

// Drops views with fewer than min_observations, and cameras without views.
void DropEmptyViews(std::size_t min_observations, map::MapData* data);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_FILTER_H_
