// SPDX-License-Identifier: Apache-2.0
#include "server/movers/moving_groups.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <numeric>

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;

// Chi-square of two degrees, 99 %.
constexpr double kMaxDifference = 9.21;
// Points of one body stand at heights up to a third or so of the camera's, and
// turn with it: lifted to the ground their speeds differ by this share (1
// sigma) without any noise.
constexpr double kShapeShare = 0.15;
// The errors of a group's points have the pose in common: more than so many say
// no more.
constexpr double kIndependentPoints = 4.0;

bool MoveAlike(const MovingPoint& a, const MovingPoint& b) {
  const Vector2d difference = a.velocity_m_s - b.velocity_m_s;
  const double shape_m_s =
      kShapeShare * 0.5 * (a.velocity_m_s.norm() + b.velocity_m_s.norm());
  const Matrix2d covariance = a.velocity_covariance_m2_s2 +
                              b.velocity_covariance_m2_s2 +
                              shape_m_s * shape_m_s * Matrix2d::Identity();
  return difference.dot(covariance.ldlt().solve(difference)) < kMaxDifference;
}

std::size_t RootOf(std::vector<std::size_t>& parents, std::size_t i) {
  while (parents[i] != i) {
    parents[i] = parents[parents[i]];
    i = parents[i];
  }
  return i;
}

MovingGroup Summarize(std::vector<std::size_t> members,
                      std::span<const MovingPoint> points) {
  MovingGroup group;
  group.members = std::move(members);
  Vector2d min_px = points[group.members.front()].pixel_px;
  Vector2d max_px = min_px;
  Matrix2d information = Matrix2d::Zero();
  Vector2d weighted = Vector2d::Zero();
  for (const std::size_t i : group.members) {
    const MovingPoint& point = points[i];
    min_px = min_px.cwiseMin(point.pixel_px);
    max_px = max_px.cwiseMax(point.pixel_px);
    const Matrix2d weight = point.velocity_covariance_m2_s2.inverse();
    information += weight;
    weighted += weight * point.velocity_m_s;
  }
  group.box_px = {min_px, max_px};
  const Matrix2d covariance = information.inverse();
  const double count = static_cast<double>(group.members.size());
  group.velocity_m_s = covariance * weighted;
  group.velocity_covariance_m2_s2 =
      covariance * (count / std::min(count, kIndependentPoints));
  return group;
}

}  // namespace

std::vector<MovingGroup> GroupPoints(std::span<const MovingPoint> points,
                                     const GroupingOptions& options) {
  std::vector<std::size_t> parents(points.size());
  std::iota(parents.begin(), parents.end(), std::size_t{0});
  const double link_squared = options.link_px * options.link_px;
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const double apart_squared =
          (points[i].pixel_px - points[j].pixel_px).squaredNorm();
      if (apart_squared > link_squared) continue;
      const std::size_t a = RootOf(parents, i);
      const std::size_t b = RootOf(parents, j);
      if (a != b && MoveAlike(points[i], points[j])) {
        parents[std::max(a, b)] = std::min(a, b);
      }
    }
  }
  std::vector<std::vector<std::size_t>> members(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    members[RootOf(parents, i)].push_back(i);
  }
  std::vector<MovingGroup> groups;
  for (auto& of_one : members) {
    if (of_one.size() < options.min_members) continue;
    groups.push_back(Summarize(std::move(of_one), points));
  }
  return groups;
}

}  // namespace groundlock::movers
