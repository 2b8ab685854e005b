// SPDX-License-Identifier: Apache-2.0
// A ground plane as the landmarks on it fit it, and how well they tell it.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_FIT_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_FIT_H_

#include "map_store/geometry/plane.h"
#include "map_store/map/internal/ground_scene.h"

namespace groundlock::map::internal {

// Half-width of the band of landmarks that the ground is fitted to, in
// tolerances, once it is known.
inline constexpr double kGroundBand = 0.5;

// Weighted total least squares on the landmarks in a band about the plane that
// narrows: what stands on the ground is above it and would lift the plane;
// narrowing moves it to where the landmarks are densest. A landmark's weight is
// 1 / tolerance^2, since errors grow with the distance to it.
geometry::Plane Narrowed(const GroundScene& scene, geometry::Plane plane);

// The cameras' mean distance to the plane.
double MeanHeight(const GroundScene& scene, const geometry::Plane& plane);

// How far the fit hangs on single stretches of the ground, which neither is
// flat nor has independent errors: the jackknife over eight of them, along
// where it is longest. Source: Efron & Tibshirani 1993, chapter 11.
struct GroundSpread {
  double tilt_rad = 0.0;  // 1 sigma about any axis in the plane
  double height = 0.0;    // of MeanHeight, 1 sigma
  // From below the cameras to the middle of the landmarks, by their weights: a
  // tilt of the ground changes the cameras' height by as much more.
  double lever = 0.0;
};
GroundSpread SpreadOfFit(const GroundScene& scene,
                         const geometry::Plane& plane);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_GROUND_FIT_H_
