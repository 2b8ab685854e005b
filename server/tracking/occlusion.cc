// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/occlusion.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::ConvexPolygon;

// Two bodies are apart if their middles are so far from each other, in the sum
// of half the sides of their footprints.
constexpr double kApart = 0.7;
// Points on one surface differ by no more than this share of their range.
constexpr double kSameDepth = 0.2;
// A point counts with so many others near it.
constexpr int kNeighbours = 2;

double Side_m(const geometry::Box3& box) {
  return std::sqrt(box.size_m.x() * box.size_m.y());
}

}  // namespace

bool AreApart(const ExpectedBody& a, const ExpectedBody& b) {
  const double apart_m =
      kApart * 0.5 * (Side_m(a.box_world) + Side_m(b.box_world));
  return (a.box_world.BottomCenterWorld() - b.box_world.BottomCenterWorld())
             .norm() > apart_m;
}

bool StandsBefore(const Eigen::Vector3d& eye_world,
                  const ExpectedBody& nearer,
                  const ExpectedBody& farther) {
  return AreApart(nearer, farther) &&
         (nearer.box_world.BottomCenterWorld() - eye_world).norm() <
             (farther.box_world.BottomCenterWorld() - eye_world).norm();
}

BoxCover::BoxCover(const Box2& box_px) : box_px_(box_px) {}

Eigen::Vector2d BoxCover::CellSize_px() const {
  return box_px_.size_px().cwiseQuotient(Eigen::Vector2d(kColumns, kRows));
}

template <typename Visit>
void BoxCover::VisitCells(const ConvexPolygon& body_px,
                          const Visit& visit) const {
  const Eigen::Vector2d cell_px = CellSize_px();
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Eigen::Vector2d center_px =
          box_px_.min_px +
          cell_px.cwiseProduct(Eigen::Vector2d(column + 0.5, row + 0.5));
      if (body_px.Contains(center_px)) visit(row, column);
    }
  }
}

void BoxCover::Add(const ConvexPolygon& body_px) {
  VisitCells(body_px,
             [&](int row, int column) { hidden_[row + 1][column + 1] = true; });
}

void BoxCover::MarkBetween(const Eigen::Vector2d& a_px,
                           const Eigen::Vector2d& b_px,
                           Cells& cells) const {
  const Eigen::Vector2d cell_px = CellSize_px();
  const Eigen::Vector2d from =
      (a_px - box_px_.min_px).cwiseQuotient(cell_px) + Eigen::Vector2d::Ones();
  const Eigen::Vector2d way = (b_px - a_px).cwiseQuotient(cell_px);
  // Points are at most kLinkSides apart: the way is a few cells.
  const int steps = 1 + static_cast<int>(2.0 * way.cwiseAbs().maxCoeff());
  for (int i = 0; i <= steps; ++i) {
    const Eigen::Vector2d at = from + way * i / steps;
    if (!(at.minCoeff() >= 0.0) || at.x() >= kColumns + 2 ||
        at.y() >= kRows + 2) {
      continue;
    }
    cells[static_cast<int>(at.y())][static_cast<int>(at.x())] = true;
  }
}

void BoxCover::Add(std::span<const FrontPoint> points) {
  if (!box_px_.IsFinite() || !(box_px_.size_px().minCoeff() > 0.0)) return;
  points = points.first(std::min(points.size(), kMaxPoints));
  const double link_px = kLinkSides * std::sqrt(box_px_.Area());
  struct Link {
    std::size_t a;
    std::size_t b;
  };
  std::vector<Link> links;
  std::array<int, kMaxPoints> neighbours{};
  for (std::size_t a = 0; a < points.size(); ++a) {
    for (std::size_t b = a + 1; b < points.size(); ++b) {
      const double range_m = std::min(points[a].range_m, points[b].range_m);
      const bool are_near =
          (points[a].pixel_px - points[b].pixel_px).norm() <= link_px &&
          std::abs(points[a].range_m - points[b].range_m) <=
              kSameDepth * range_m;
      if (!are_near) continue;
      links.push_back({a, b});
      ++neighbours[a];
      ++neighbours[b];
    }
  }
  Cells marked{};
  for (const Link& link : links) {
    if (neighbours[link.a] < kNeighbours || neighbours[link.b] < kNeighbours) {
      continue;
    }
    MarkBetween(points[link.a].pixel_px, points[link.b].pixel_px, marked);
  }
  for (int row = 1; row <= kRows; ++row) {
    for (int column = 1; column <= kColumns; ++column) {
      for (int k = 0; k < 9; ++k) {
        if (marked[row + k / 3 - 1][column + k % 3 - 1]) {
          hidden_[row][column] = true;
        }
      }
    }
  }
}

double BoxCover::share() const {
  int hidden = 0;
  for (const auto& row : hidden_) {
    hidden += static_cast<int>(std::count(row.begin(), row.end(), true));
  }
  return static_cast<double>(hidden) / (kColumns * kRows);
}

double BoxCover::ShareOf(const Box2& part_px) const {
  const Eigen::Vector2d cell_px = CellSize_px();
  int hidden = 0;
  int all = 0;
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Eigen::Vector2d corner_px =
          box_px_.min_px + cell_px.cwiseProduct(Eigen::Vector2d(column, row));
      const Box2 cell{corner_px, corner_px + cell_px};
      if (!(Intersection(cell, part_px).Area() > 0.0)) continue;
      ++all;
      hidden += hidden_[row + 1][column + 1] ? 1 : 0;
    }
  }
  return all > 0 ? static_cast<double>(hidden) / all : 0.0;
}

double BoxCover::ShareOf(const ConvexPolygon& body_px) const {
  int hidden = 0;
  int all = 0;
  VisitCells(body_px, [&](int row, int column) {
    ++all;
    hidden += hidden_[row + 1][column + 1] ? 1 : 0;
  });
  return all > 0 ? static_cast<double>(hidden) / all : 0.0;
}

}  // namespace groundlock::tracking
