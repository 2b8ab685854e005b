// SPDX-License-Identifier: Apache-2.0
// What the size of a target's body says of it. Sizes are length, width and
// height, in metres or map units.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_SIZE_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_SIZE_H_

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>

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
