// SPDX-License-Identifier: Apache-2.0
// Axis-aligned boxes in the image and upright boxes on the ground.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_BOX_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_BOX_H_

#include <Eigen/Core>
#include <array>

#include "map_store/geometry/rigid3.h"

namespace groundlock::geometry {

// Half-open image box [min_px, max_px). Continuous pixels: the image covers
// (0, 0) to (width, height) and the first pixel's centre is (0.5, 0.5).
struct Box2 {
  Eigen::Vector2d min_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d max_px = Eigen::Vector2d::Zero();

  static Box2 FromXywh(double x, double y, double width, double height) {
    return {{x, y}, {x + width, y + height}};
  }
  static Box2 FromCenter(const Eigen::Vector2d& center_px,
                         const Eigen::Vector2d& size_px) {
    return {center_px - 0.5 * size_px, center_px + 0.5 * size_px};
  }

  double x() const { return min_px.x(); }
  double y() const { return min_px.y(); }
  double width() const { return max_px.x() - min_px.x(); }
  double height() const { return max_px.y() - min_px.y(); }
  Eigen::Vector2d size_px() const { return max_px - min_px; }
  Eigen::Vector2d center_px() const { return 0.5 * (min_px + max_px); }
  // Zero for boxes that are empty or inverted.
  double Area() const;
  bool IsFinite() const { return min_px.allFinite() && max_px.allFinite(); }
  bool Contains(const Eigen::Vector2d& point_px) const;
};

// The common part; empty (zero area) if there is none.
Box2 Intersection(const Box2& a, const Box2& b);
// Intersection over union, 0 if both are empty.
double IntersectionOverUnion(const Box2& a, const Box2& b);

// An upright box in 3D. Object frame: x along the heading (length), y to the
// left (width), z up (height); its origin is the centre of the box's volume.
struct Box3 {
  Rigid3 world_from_object;
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  // length, width, height

  // Corners in world, index bits: 1 = +x, 2 = +y, 4 = +z.
  std::array<Eigen::Vector3d, 8> CornersWorld() const;
  // Centre of the lower face.
  Eigen::Vector3d BottomCenterWorld() const;
};

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_BOX_H_
