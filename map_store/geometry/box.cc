// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/box.h"

#include <algorithm>
#include <cstddef>

namespace groundlock::geometry {

double Box2::Area() const {
  if (width() <= 0.0 || height() <= 0.0) return 0.0;
  return width() * height();
}

bool Box2::Contains(const Eigen::Vector2d& point_px) const {
  return (point_px.array() >= min_px.array()).all() &&
         (point_px.array() < max_px.array()).all();
}

Box2 Intersection(const Box2& a, const Box2& b) {
  Box2 common{a.min_px.cwiseMax(b.min_px), a.max_px.cwiseMin(b.max_px)};
  common.max_px = common.max_px.cwiseMax(common.min_px);
  return common;
}

double IntersectionOverUnion(const Box2& a, const Box2& b) {
  const double common = Intersection(a, b).Area();
  const double all = a.Area() + b.Area() - common;
  return all > 0.0 ? common / all : 0.0;
}

std::array<Eigen::Vector3d, 8> Box3::CornersWorld() const {
  std::array<Eigen::Vector3d, 8> corners;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d half((i & 1U) != 0 ? 0.5 : -0.5,
                               (i & 2U) != 0 ? 0.5 : -0.5,
                               (i & 4U) != 0 ? 0.5 : -0.5);
    corners[i] = world_from_object * half.cwiseProduct(size_m);
  }
  return corners;
}

Eigen::Vector3d Box3::BottomCenterWorld() const {
  return world_from_object * Eigen::Vector3d(0.0, 0.0, -0.5 * size_m.z());
}

}  // namespace groundlock::geometry
