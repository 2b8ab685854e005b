// SPDX-License-Identifier: Apache-2.0
// Convex outlines in the image.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_CONVEX_POLYGON_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_CONVEX_POLYGON_H_

#include <Eigen/Core>
#include <vector>

#include "map_store/geometry/box.h"

namespace groundlock::geometry {

// Corners in order, turning from the image's x axis to its y axis (clockwise as
// one sees it). Continuous pixels, as for Box2.
struct ConvexPolygon {
  std::vector<Eigen::Vector2d> corners_px;

  // Points on an edge are inside. Nothing is in a polygon of fewer than three
  // corners.
  bool Contains(const Eigen::Vector2d& point_px) const;
  // The box about it. Needs a corner.
  Box2 Bounds() const;
};

// The smallest one about finite points, without corners on a straight edge. Has
// fewer than three corners if all points are on one line.
// Source: Andrew, "Another efficient algorithm for convex hulls in two
// dimensions" (Information Processing Letters 9, 1979).
ConvexPolygon ConvexHull(std::vector<Eigen::Vector2d> points_px);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_CONVEX_POLYGON_H_
