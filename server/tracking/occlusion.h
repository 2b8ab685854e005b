// SPDX-License-Identifier: Apache-2.0
// How much of a target is hidden by what stands between it and the camera.
#ifndef GROUNDLOCK_SERVER_TRACKING_OCCLUSION_H_
#define GROUNDLOCK_SERVER_TRACKING_OCCLUSION_H_

#include <Eigen/Core>
#include <array>
#include <span>
#include <string>

#include "map_store/geometry/box.h"
#include "map_store/geometry/convex_polygon.h"

namespace groundlock::tracking {

// A target as it is expected in a frame. Lengths in metres or map units.
struct ExpectedBody {
  std::string id;
  geometry::Box3 box_world;
  geometry::Box2 outline_px;        // about the body
  geometry::ConvexPolygon body_px;  // what it takes of the image
  double sigma_m = 0.0;             // of its distance from the camera
  bool is_seen = false;  // in the last frame that was looked at for it
};

// Bodies are solid: two that would be in one another are one thing (a rider and
// what is ridden), or badly known.
bool AreApart(const ExpectedBody& a, const ExpectedBody& b);
// Of two that are apart: does `nearer` stand before `farther`, seen from
// `eye_world`? Where they are in the image does not count.
bool StandsBefore(const Eigen::Vector3d& eye_world,
                  const ExpectedBody& nearer,
                  const ExpectedBody& farther);

// A point of a surface that stands before a target.
struct FrontPoint {
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
  double range_m = 0.0;  // from the camera
};

// Which parts of a box in the image are hidden, on a coarse grid.
class BoxCover {
 public:
  // In sides (square roots of the area) of the box: points that are no farther
  // apart may be on one surface, so that those as far outside the box matter.
  static constexpr double kLinkSides = 0.5;
  // Points beyond so many are not looked at.
  static constexpr std::size_t kMaxPoints = 96;

  // A box of no size has nothing to hide.
  explicit BoxCover(const geometry::Box2& box_px);
  // Hides the cells whose centres are in the body.
  void Add(const geometry::ConvexPolygon& body_px);
  // Points near each other in the image and in depth are taken for one surface,
  // which hides what lies between them and, for a surface does not end at its
  // outermost landmark, a cell beyond. One that has not two such neighbours may
  // be an error and hides nothing.
  void Add(std::span<const FrontPoint> points);
  // In [0, 1].
  double share() const;
  // Of the cells that a part of the box meets; 0 if it meets none.
  double ShareOf(const geometry::Box2& part_px) const;
  // Of the cells whose centres are in a body; 0 if none is.
  double ShareOf(const geometry::ConvexPolygon& body_px) const;

 private:
  static constexpr int kColumns = 10;
  static constexpr int kRows = 6;
  // The box's cells and one more around them: [row + 1][column + 1].
  using Cells = std::array<std::array<bool, kColumns + 2>, kRows + 2>;

  Eigen::Vector2d CellSize_px() const;
  // Calls `visit` with the row and column of each cell whose centre is in it.
  template <typename Visit>
  void VisitCells(const geometry::ConvexPolygon& body_px,
                  const Visit& visit) const;
  void MarkBetween(const Eigen::Vector2d& a_px,
                   const Eigen::Vector2d& b_px,
                   Cells& cells) const;

  geometry::Box2 box_px_;
  Cells hidden_{};
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_OCCLUSION_H_
