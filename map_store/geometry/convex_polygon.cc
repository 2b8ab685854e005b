// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/convex_polygon.h"

#include <algorithm>

namespace groundlock::geometry {
namespace {

// Twice the signed area of a triangle; positive if it turns from x to y.
double Turn(const Eigen::Vector2d& a,
            const Eigen::Vector2d& b,
            const Eigen::Vector2d& c) {
  const Eigen::Vector2d ab = b - a;
  const Eigen::Vector2d ac = c - a;
  return ab.x() * ac.y() - ab.y() * ac.x();
}

}  // namespace

bool ConvexPolygon::Contains(const Eigen::Vector2d& point_px) const {
  if (corners_px.size() < 3) return false;
  for (std::size_t i = 0; i < corners_px.size(); ++i) {
    const Eigen::Vector2d& next = corners_px[(i + 1) % corners_px.size()];
    if (!(Turn(corners_px[i], next, point_px) >= 0.0)) return false;
  }
  return true;
}

Box2 ConvexPolygon::Bounds() const {
  Box2 bounds{corners_px.front(), corners_px.front()};
  for (const Eigen::Vector2d& corner_px : corners_px) {
    bounds.min_px = bounds.min_px.cwiseMin(corner_px);
    bounds.max_px = bounds.max_px.cwiseMax(corner_px);
  }
  return bounds;
}

ConvexPolygon ConvexHull(std::vector<Eigen::Vector2d> points_px) {
  if (points_px.empty()) return {};
  std::sort(points_px.begin(),
            points_px.end(),
            [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
              return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
            });
  // There and back along the points, each time the side that lies outside.
  ConvexPolygon hull;
  std::vector<Eigen::Vector2d>& corners = hull.corners_px;
  for (int way = 0; way < 2; ++way) {
    const std::size_t start = corners.size();
    for (const Eigen::Vector2d& point : points_px) {
      while (
          corners.size() >= start + 2 &&
          !(Turn(corners[corners.size() - 2], corners.back(), point) > 0.0)) {
        corners.pop_back();
      }
      corners.push_back(point);
    }
    // The other way begins there.
    corners.pop_back();
    std::reverse(points_px.begin(), points_px.end());
  }
  return hull;
}

}  // namespace groundlock::geometry
