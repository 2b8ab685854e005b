// SPDX-License-Identifier: Apache-2.0
#include "server/movers/point_field.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/image/frame.h"
#include "server/image/patch_flow.h"

namespace groundlock::movers {
namespace {

using Eigen::Vector2d;
using geometry::Box2;
using image::kPixelCenter;

// Larger frames are looked at in a halved picture.
constexpr int kMaxSide_px = 2'048;
constexpr double kCells = 800.0;
// The rest is kept for where something moves.
constexpr std::size_t kMaxSpreadPoints = 850;
constexpr int kMinCell_px = 16;
// Corners are looked for in a picture halved once more; each cell's turn comes
// so often.
constexpr auto kSweep = std::chrono::milliseconds(300);
constexpr int kCornerBlock_px = 5;
// Least eigenvalue of cv::cornerMinEigenVal: a slope of some 2 levels per pixel
// in every direction.
constexpr float kMinCorner = 2e-4F;
// Along an edge a point slides: its least slope is this share, squared, of its
// greatest.
constexpr double kMinRoundness = 0.08;
// Mean squared slope, (8-bit levels / px)^2; noise of a standard deviation of
// 1.5 levels has 1.1.
constexpr double kMinSlopeSquared = 5.0;
// A patch that differs from the frame before by more (mean of 8-bit levels) is
// hidden, or was not found.
constexpr double kMaxDifference = 25.0;
// One that differs by no more is the same: other places need not be tried.
constexpr double kSureDifference = 4.0;
// What lies nearer to the border is about to leave.
constexpr double kRim_px = 6.0;
// Two points nearer than this are one.
constexpr double kCrowded_px = 4.0;
constexpr double kMaxReturn_px = 0.8;
// The frame-to-frame error of Lucas-Kanade, added up over a second
// (body_follower.cc measured as much).
constexpr double kSigma_px = 0.5;
// Where something moves, points are as near as a tenth of its size allows.
constexpr double kBusySpacing = 0.1;
constexpr double kMinBusySpacing_px = 6.0;
constexpr int kMaxBusyCorners = 40;
constexpr int kMaxBusyPixels = 60'000;  // of one frame

// Whether the picture around a pixel has texture in every direction: more than
// noise, and not along one edge alone.
bool IsCorner(const cv::Mat& picture, const cv::Point& at) {
  constexpr int kHalf = 4;
  if (at.x <= kHalf || at.y <= kHalf || at.x + kHalf + 1 >= picture.cols ||
      at.y + kHalf + 1 >= picture.rows) {
    return false;
  }
  double xx = 0.0, xy = 0.0, yy = 0.0;
  for (int y = at.y - kHalf; y <= at.y + kHalf; ++y) {
    const std::uint8_t* above = picture.ptr<std::uint8_t>(y - 1);
    const std::uint8_t* row = picture.ptr<std::uint8_t>(y);
    const std::uint8_t* below = picture.ptr<std::uint8_t>(y + 1);
    for (int x = at.x - kHalf; x <= at.x + kHalf; ++x) {
      const double dx = row[x + 1] - row[x - 1];
      const double dy = below[x] - above[x];
      xx += dx * dx;
      xy += dx * dy;
      yy += dy * dy;
    }
  }
  const double half_trace = 0.5 * (xx + yy);
  const double root = std::hypot(0.5 * (xx - yy), xy);
  // Differences are over two pixels.
  constexpr double kSquares = 4.0 * (2 * kHalf + 1) * (2 * kHalf + 1);
  return half_trace - root > kMinSlopeSquared * kSquares &&
         half_trace - root > kMinRoundness * (half_trace + root);
}

bool IsWithinAny(const Vector2d& pixel_px, std::span<const Box2> boxes_px) {
  return std::any_of(boxes_px.begin(), boxes_px.end(), [&](const Box2& box) {
    return box.Contains(pixel_px);
  });
}

}  // namespace

PointField::Layout PointField::LayoutOf(const image::LumaPyramid& pyramid) {
  Layout layout;
  layout.size_px = pyramid.size_px;
  const int levels = static_cast<int>(pyramid.levels.size());
  while (std::max(pyramid.size_px.width, pyramid.size_px.height) >>
             layout.level > kMaxSide_px &&
         layout.level + 2 < levels) {
    ++layout.level;
  }
  const int width = pyramid.size_px.width >> layout.level;
  const int height = pyramid.size_px.height >> layout.level;
  layout.cell_px = std::max(
      kMinCell_px,
      static_cast<int>(std::ceil(std::sqrt(1.0 * width * height / kCells))));
  layout.cells = {std::max(1, width / layout.cell_px),
                  std::max(1, height / layout.cell_px)};
  return layout;
}

double PointField::sigma_px() const { return kSigma_px * (1 << layout_.level); }

void PointField::Clear() {
  points_.clear();
  before_px_.clear();
  next_row_ = 0;
}

void PointField::Follow(const image::LumaPyramid& from,
                        const image::LumaPyramid& to,
                        std::chrono::nanoseconds step,
                        const Expectation& expected_px,
                        std::span<const Box2> without_px) {
  layout_ = LayoutOf(to);
  // In a long step something moves farther than the patches of a fine level
  // find it. What moves as expected is found at once; coarse patches of it hold
  // more of what is behind it.
  image::PatchFlowOptions anywhere{
      .coarsest_level =
          layout_.level + (step > std::chrono::milliseconds(60) ? 3 : 2),
      .finest_level = layout_.level};
  image::PatchFlowOptions nearby = anywhere;
  nearby.coarsest_level = layout_.level + 1;
  const double rim_px = kRim_px * (1 << layout_.level);
  std::vector<FieldPoint> found;
  std::vector<cv::Point2d> before_px;
  found.reserve(points_.size());
  before_px.reserve(points_.size());
  for (FieldPoint& point : points_) {
    const Starts starts = expected_px(point);
    std::optional<image::PatchFlow> flow;
    for (std::size_t i = 0; i < starts.count; ++i) {
      if (flow && flow->difference <= kSureDifference) break;
      const Vector2d& start_px = starts.pixel_px[i];
      if (!start_px.allFinite()) continue;
      const auto there = image::FollowPatch(
          from,
          to,
          {point.pixel_px.x(), point.pixel_px.y()},
          {start_px.x(), start_px.y()},
          point.kind == FieldPoint::Kind::kMoving ? nearby : anywhere);
      if (there && (!flow || there->difference < flow->difference)) {
        flow = there;
      }
    }
    if (!flow || flow->difference > kMaxDifference) continue;
    const Vector2d pixel_px(flow->point_px.x, flow->point_px.y);
    if (!(pixel_px.x() > rim_px && pixel_px.y() > rim_px &&
          pixel_px.x() < to.size_px.width - rim_px &&
          pixel_px.y() < to.size_px.height - rim_px) ||
        IsWithinAny(pixel_px, without_px)) {
      continue;
    }
    before_px.emplace_back(point.pixel_px.x(), point.pixel_px.y());
    point.pixel_px = pixel_px;
    found.push_back(std::move(point));
  }
  points_ = std::move(found);
  before_px_ = std::move(before_px);
  ForgetCrowded();
}

void PointField::ForgetCrowded() {
  // Of points that have run together the older one stays.
  const double side_px = kCrowded_px * (1 << layout_.level);
  const int columns =
      static_cast<int>(std::ceil(layout_.size_px.width / side_px)) + 1;
  const int rows =
      static_cast<int>(std::ceil(layout_.size_px.height / side_px)) + 1;
  std::vector<bool> taken(static_cast<std::size_t>(columns) * rows, false);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const auto column = static_cast<int>(points_[i].pixel_px.x() / side_px);
    const auto row = static_cast<int>(points_[i].pixel_px.y() / side_px);
    auto cell =
        taken.begin() + static_cast<std::ptrdiff_t>(row) * columns + column;
    if (*cell) continue;
    *cell = true;
    if (kept != i) {
      points_[kept] = std::move(points_[i]);
      before_px_[kept] = before_px_[i];
    }
    ++kept;
  }
  points_.resize(kept);
  before_px_.resize(kept);
}

void PointField::ForgetUnreturned(const image::LumaPyramid& now,
                                  const image::LumaPyramid& before) {
  const image::PatchFlowOptions back{.coarsest_level = layout_.level + 1,
                                     .finest_level = layout_.level};
  const double limit_px = kMaxReturn_px * (1 << layout_.level);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (points_[i].kind == FieldPoint::Kind::kMoving) {
      const auto flow =
          image::FollowPatch(now,
                             before,
                             {points_[i].pixel_px.x(), points_[i].pixel_px.y()},
                             before_px_[i],
                             back);
      if (!flow || std::hypot(flow->point_px.x - before_px_[i].x,
                              flow->point_px.y - before_px_[i].y) > limit_px) {
        continue;
      }
    }
    if (kept != i) {
      points_[kept] = std::move(points_[i]);
      before_px_[kept] = before_px_[i];
    }
    ++kept;
  }
  points_.resize(kept);
  before_px_.resize(kept);
}

void PointField::Add(const Vector2d& pixel_px) {
  FieldPoint point;
  point.id = next_id_++;
  point.pixel_px = pixel_px;
  point.key_pixel_px = pixel_px;
  points_.push_back(std::move(point));
}

void PointField::Seed(const image::LumaPyramid& pyramid,
                      std::chrono::nanoseconds step,
                      std::span<const Box2> without_px) {
  layout_ = LayoutOf(pyramid);
  const int rows = static_cast<int>(std::ceil(
      std::clamp(1.0 * step.count() / std::chrono::nanoseconds(kSweep).count(),
                 0.0,
                 1.0) *
      layout_.cells.height));
  SeedRows(pyramid, std::max(1, rows), without_px);
}

void PointField::SeedBusy(const image::LumaPyramid& pyramid,
                          std::span<const Box2> busy_px,
                          std::span<const Box2> without_px) {
  double pixels = 0.0;
  const double scale = 1 << layout_.level;
  for (const Box2& box_px : busy_px) {
    const double area = box_px.Area() / (scale * scale);
    if (pixels + area > kMaxBusyPixels) continue;
    pixels += area;
    SeedBox(pyramid, box_px, without_px);
  }
}

std::size_t PointField::CellOf(const Vector2d& pixel_px) const {
  const double side_px = layout_.cell_px * (1 << layout_.level);
  const int column = std::clamp(
      static_cast<int>(pixel_px.x() / side_px), 0, layout_.cells.width - 1);
  const int row = std::clamp(
      static_cast<int>(pixel_px.y() / side_px), 0, layout_.cells.height - 1);
  return static_cast<std::size_t>(row) * layout_.cells.width + column;
}

void PointField::Thin() {
  // Points are in the order of their age.
  std::vector<bool> rests(static_cast<std::size_t>(layout_.cells.area()),
                          false);
  std::erase_if(points_, [&](const FieldPoint& point) {
    if (point.kind != FieldPoint::Kind::kAtRest) return false;
    auto cell =
        rests.begin() + static_cast<std::ptrdiff_t>(CellOf(point.pixel_px));
    if (*cell) return true;
    *cell = true;
    return false;
  });
  before_px_.clear();
}

void PointField::SeedRows(const image::LumaPyramid& pyramid,
                          int rows,
                          std::span<const Box2> without_px) {
  const double scale = 1 << layout_.level;
  const cv::Size cells = layout_.cells;
  next_row_ %= cells.height;
  const int end_row = std::min(next_row_ + rows, cells.height);
  std::vector<bool> taken(static_cast<std::size_t>(cells.area()), false);
  for (const FieldPoint& point : points_) taken[CellOf(point.pixel_px)] = true;
  const int corner_level =
      std::min(layout_.level + 1, static_cast<int>(pyramid.levels.size()) - 1);
  const double per_corner_px = 1 << corner_level;
  const double corner_cell = layout_.cell_px * scale / per_corner_px;
  const cv::Mat& picture = pyramid.levels[corner_level];
  const int top = static_cast<int>(next_row_ * corner_cell);
  const int bottom =
      std::min(static_cast<int>(end_row * corner_cell), picture.rows);
  next_row_ = end_row % cells.height;
  if (bottom - top <= kCornerBlock_px) return;
  cv::Mat corners;
  cv::cornerMinEigenVal(
      picture.rowRange(top, bottom), corners, kCornerBlock_px, 3);
  const int first_row = static_cast<int>(top / corner_cell + 0.5);
  for (int row = first_row; row < end_row; ++row) {
    for (int column = 0; column < cells.width; ++column) {
      if (taken[static_cast<std::size_t>(row) * cells.width + column] ||
          points_.size() >= kMaxSpreadPoints) {
        continue;
      }
      const int x = static_cast<int>(column * corner_cell);
      const int y = static_cast<int>(row * corner_cell) - top;
      const cv::Rect cell = cv::Rect(x,
                                     std::max(0, y),
                                     static_cast<int>(corner_cell),
                                     static_cast<int>(corner_cell)) &
                            cv::Rect(cv::Point(), corners.size());
      if (cell.empty()) continue;
      double best = 0.0;
      cv::Point at;
      cv::minMaxLoc(corners(cell), nullptr, &best, nullptr, &at);
      if (best < kMinCorner ||
          !IsCorner(picture, cv::Point(cell.x + at.x, top + cell.y + at.y))) {
        continue;
      }
      const Vector2d pixel_px =
          per_corner_px * Vector2d(cell.x + at.x + kPixelCenter,
                                   top + cell.y + at.y + kPixelCenter);
      if (!IsWithinAny(pixel_px, without_px)) Add(pixel_px);
    }
  }
}

void PointField::SeedBox(const image::LumaPyramid& pyramid,
                         const Box2& box_px,
                         std::span<const Box2> without_px) {
  const double scale = 1 << layout_.level;
  const cv::Mat& picture = pyramid.levels[layout_.level];
  const cv::Rect region =
      cv::Rect(cv::Point(static_cast<int>(box_px.x() / scale),
                         static_cast<int>(box_px.y() / scale)),
               cv::Point(static_cast<int>(box_px.max_px.x() / scale),
                         static_cast<int>(box_px.max_px.y() / scale))) &
      cv::Rect(cv::Point(), picture.size());
  if (region.width <= kCornerBlock_px || region.height <= kCornerBlock_px) {
    return;
  }
  const double spacing_px =
      std::max(kMinBusySpacing_px,
               kBusySpacing * std::sqrt(static_cast<double>(region.area())));
  cv::Mat free(region.size(), CV_8UC1, cv::Scalar(255));
  int inside = 0;
  for (const FieldPoint& point : points_) {
    const cv::Point at(static_cast<int>(point.pixel_px.x() / scale) - region.x,
                       static_cast<int>(point.pixel_px.y() / scale) - region.y);
    if (at.x < 0 || at.y < 0 || at.x >= region.width || at.y >= region.height) {
      continue;
    }
    ++inside;
    cv::circle(
        free, at, static_cast<int>(spacing_px), cv::Scalar(0), cv::FILLED);
  }
  const std::size_t room =
      std::min(kMaxPoints - std::min(kMaxPoints, points_.size()),
               static_cast<std::size_t>(std::max(0, kMaxBusyCorners - inside)));
  if (room == 0) return;
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(picture(region),
                          corners,
                          static_cast<int>(room),
                          0.02,
                          spacing_px,
                          free,
                          kCornerBlock_px);
  for (const cv::Point2f& corner : corners) {
    if (!IsCorner(picture,
                  cv::Point(region.x + static_cast<int>(corner.x),
                            region.y + static_cast<int>(corner.y)))) {
      continue;
    }
    const Vector2d pixel_px =
        scale * Vector2d(region.x + corner.x + kPixelCenter,
                         region.y + corner.y + kPixelCenter);
    if (!IsWithinAny(pixel_px, without_px)) Add(pixel_px);
  }
}

}  // namespace groundlock::movers
