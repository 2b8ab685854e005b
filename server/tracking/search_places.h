// SPDX-License-Identifier: Apache-2.0
// Where to look for a target that is not where it was predicted.
#ifndef GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_
#define GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_

#include <Eigen/Core>
#include <vector>

#include "map_store/geometry/box.h"

namespace groundlock::tracking {

// Offsets (pixels) of a grid of half the box's size over the two-sigma ellipse
// of `covariance_px2`, nearest in Mahalanobis distance first, without the
// centre, at most kMaxSearchPlaces. A tracker that sees twice the box's size
// finds what lies within half a box of where it is placed.
inline constexpr int kMaxSearchPlaces = 64;
std::vector<Eigen::Vector2d> SearchOffsets(
    const Eigen::Vector2d& box_size_px, const Eigen::Matrix2d& covariance_px2);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_
