// SPDX-License-Identifier: Apache-2.0
// Whether the landmarks of a plane are a ground, or what stands on one.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SUPPORT_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SUPPORT_H_

#include <functional>

#include "map_store/geometry/plane.h"
#include "map_store/map/internal/ground_scene.h"

namespace groundlock::map::internal {

// More landmarks lie on the plane than chance puts there from the layer right
// above it, and they lie all around each other, not along lines: a plane that
// only cuts through walls has as many landmarks at every height, along their
// feet.
bool StandsOut(const GroundScene& scene, const geometry::Plane& plane);

// How sure the plane's height is against planes parallel to it: 1 sigma over
// the cameras' mean height above it.
//   weight_of  of a plane as an explanation, against `plane` itself with 1
double HeightSigmaShare(
    const GroundScene& scene,
    const geometry::Plane& plane,
    const std::function<double(const geometry::Plane&)>& weight_of);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_SUPPORT_H_
