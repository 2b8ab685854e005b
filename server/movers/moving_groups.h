// SPDX-License-Identifier: Apache-2.0
// Neighbours in the image that go over the ground alike are one thing.
#ifndef GROUNDLOCK_SERVER_MOVERS_MOVING_GROUPS_H_
#define GROUNDLOCK_SERVER_MOVERS_MOVING_GROUPS_H_

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "map_store/geometry/box.h"

namespace groundlock::movers {

// A point that moves, in axes of the ground's reference plane.
struct MovingPoint {
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Zero();
};

struct MovingGroup {
  std::vector<std::size_t> members;  // indices of the points, ascending
  geometry::Box2 box_px;             // around them
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Zero();
};

struct GroupingOptions {
  double link_px = 40.0;        // neighbours are no farther apart
  std::size_t min_members = 3;  // fewer are chance
};

// Single linkage: points are of one group if a chain of neighbours, each of
// which moves like the next one, joins them. Pure and thread-safe; quadratic in
// the number of points.
std::vector<MovingGroup> GroupPoints(std::span<const MovingPoint> points,
                                     const GroupingOptions& options);

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_MOVING_GROUPS_H_
