// SPDX-License-Identifier: Apache-2.0
// What cameras alone say about "up".
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_UP_EVIDENCE_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_UP_EVIDENCE_H_

#include <Eigen/Core>
#include <span>
#include <vector>

#include "map_store/geometry/rigid3.h"

namespace groundlock::map::internal {

// People and gimbals hold cameras without roll, so that up is perpendicular to
// their axes to the right, and is up rather than down in their images; and
// cameras travel along the ground rather than at it. None of it is certain
// (portrait photos, climbing drones): each camera may be an exception.
// Immutable, thread-safe.
class UpEvidence {
 public:
  // In the order in which the images were taken, as far as it is known.
  explicit UpEvidence(std::span<const geometry::Rigid3> camera_from_world);

  // Log of how well a unit vector goes with what cameras do, up to a constant;
  // 0 if nothing speaks against it.
  double LogOf(const Eigen::Vector3d& up) const;

  // How much of a turn about `up` the cameras' axes to the right make: the
  // angle that they are spread over, rad. A camera that never turns does not
  // tell how far forward or back up leans.
  double SpreadAbout_rad(const Eigen::Vector3d& up) const;

  // The mean of |cos| between the optical axes and `up`: 1 = they look straight
  // along it.
  double LooksAlong(const Eigen::Vector3d& up) const;

  // The best direction that the cameras alone give.
  Eigen::Vector3d Best() const;

 private:
  std::vector<Eigen::Vector3d> rights_;
  std::vector<Eigen::Vector3d> downs_;
  std::vector<Eigen::Vector3d> forwards_;
  std::vector<Eigen::Vector3d> ways_;  // unit, between places apart
  double num_looks_ = 0.0;             // that say something of their own
};

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_UP_EVIDENCE_H_
