// SPDX-License-Identifier: Apache-2.0
// Whether a pose rests on one surface alone. A picture that hangs in two
// places, a facade that was built twice: what is painted on one plane agrees
// with a pose as a whole, without being an accident (agreement.h), wherever
// the plane is. What else must be in view from there tells.
//
// Source: Neyman & Pearson 1933 (likelihood ratio); Fischler & Bolles 1981 (the
// plane). Thread-safe.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ONE_SURFACE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ONE_SURFACE_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>

#include "map_store/geometry/camera_model.h"

namespace groundlock::localization {

struct SeenPoint {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
};

// How much likelier what is found beside the plane on which most agrees is, if
// the camera is there, than if something else shows that plane's picture:
// natural logarithm; negative speaks against the pose. 0 where nothing else
// must be in view, and where the plane is level: the ground is hung nowhere
// else. At least log(kFalseAlarmsPerFrame): a crowd, or another time
// of the year, may hide all else.
//   agreeing  the landmarks that agree with the pose,
//   expected  those that must be in view, whether they are found or not,
//   up_world  if it is known.
double LogLikelierBesideSurface(std::span<const SeenPoint> agreeing,
                                std::span<const SeenPoint> expected,
                                const Eigen::Vector3d& center_world,
                                const std::optional<Eigen::Vector3d>& up_world,
                                const geometry::CameraModel& camera,
                                std::uint64_t seed);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ONE_SURFACE_H_
