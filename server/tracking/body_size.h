// SPDX-License-Identifier: Apache-2.0
// What the size of a target's body says of it. Sizes are length, width and
// height, in metres or map units.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_SIZE_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_SIZE_H_

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/ground/box_fit.h"

namespace groundlock::tracking {

// Lower than so many footprint sides a target is taken for a vehicle or an
// animal, which are longer than wide along their way; above, for a person.
inline constexpr double kSquat = 1.2;

inline double Side(const Eigen::Vector3d& size_m) {
  return std::sqrt(size_m.x() * size_m.y());
}

inline bool IsSquat(const Eigen::Vector3d& size_m) {
  return size_m.z() < kSquat * Side(size_m);
}

// Cars are 2.4 times as long as wide and 0.5 footprint sides tall, vans 2.5 and
// 0.7, dogs and cows 3 and 1.2, model cars 1.8 and 0.5.
inline constexpr ground::ShapePrior kSquatShape{.length_over_width = 2.0,
                                                .length_over_width_sigma = 0.3,
                                                .tallness = 0.6,
                                                .tallness_sigma = 0.3};
inline constexpr ground::ShapePrior kTallShape{.length_over_width = 1.0,
                                               .length_over_width_sigma = 0.2,
                                               .tallness = 3.0,
                                               .tallness_sigma = 0.8};

// What is taken for granted of a target's shape along its way.
inline const ground::ShapePrior& ShapeOf(const Eigen::Vector3d& size_m) {
  return IsSquat(size_m) ? kSquatShape : kTallShape;
}

// What noise scales with: a person is small on the ground, but moves as
// something of a person's height does.
inline double TypicalSize(const Eigen::Vector3d& size_m) {
  return std::max(Side(size_m), size_m.z());
}

// In [-pi, pi].
inline double WrapAngle_rad(double angle_rad) {
  return std::remainder(angle_rad, 2.0 * std::numbers::pi);
}

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BODY_SIZE_H_
