// SPDX-License-Identifier: Apache-2.0
// How well a landmark's place is known: from the views that saw it.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LANDMARK_UNCERTAINTY_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LANDMARK_UNCERTAINTY_H_

#include <Eigen/Core>
#include <cstdint>

#include "map_store/map/map.h"

namespace groundlock::localization {

// Covariance of the position in world, unit of the map squared: that of the
// triangulation from its views, with the landmark's own reprojection error (at
// least half a pixel) as the error of each observation. Directions that the
// views leave open are bounded by the distance from them. Errors that the views
// have in common are not in it. Thread-safe.
// Source: Hartley & Zisserman, 2nd ed., §5.2.
Eigen::Matrix3d LandmarkCovariance(const map::Map& map, std::uint32_t landmark);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LANDMARK_UNCERTAINTY_H_
