// SPDX-License-Identifier: Apache-2.0
// Corners all over the image, followed from frame to frame.
#ifndef GROUNDLOCK_SERVER_MOVERS_POINT_FIELD_H_
#define GROUNDLOCK_SERVER_MOVERS_POINT_FIELD_H_

#include <Eigen/Core>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <opencv2/core/types.hpp>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/image/luma_pyramid.h"
#include "server/movers/point_motion.h"

namespace groundlock::movers {

inline constexpr std::size_t kKeyViews = 9;

struct FieldPoint {
  enum class Kind {
    kNew,  // seen too seldom to tell
    kAtRest,
    kMoving,  // over the ground
    kOdd,     // neither
  };
  std::uint64_t id = 0;
  Kind kind = Kind::kNew;
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d key_pixel_px = Eigen::Vector2d::Zero();  // in the last key
  // Coordinates on z = 1 in key view n, at n modulo kKeyViews, from the first
  // that it was seen in on.
  std::array<Eigen::Vector2d, kKeyViews> xy_by_key;
  std::optional<std::uint64_t> first_key;
  // In the last key view, by FitRest.
  double inverse_depth = 0.0;
  // The ground under it, and since when that is known.
  std::optional<LocalGround> ground;
  std::uint64_t ground_key = 0;
  // kMoving: in the axes of the ground's reference plane, in the last key view.
  Eigen::Vector2d place_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Zero();
};

// Not thread-safe. Costs the same for frames of any size: of large ones it
// looks at a smaller level of the pyramid.
class PointField {
 public:
  // One of each of some 800 cells, and more where something moves.
  static constexpr std::size_t kMaxPoints = 1'200;

  void Clear();
  // Where a point may be, for the search to start from. Nothing: it is
  // forgotten.
  struct Starts {
    std::array<Eigen::Vector2d, 3> pixel_px;
    std::size_t count = 0;
    void Add(const Eigen::Vector2d& start_px) { pixel_px[count++] = start_px; }
  };
  using Expectation = std::function<Starts(const FieldPoint&)>;
  // Forgets what is not found again, or lies in one of the boxes.
  void Follow(const image::LumaPyramid& from,
              const image::LumaPyramid& to,
              std::chrono::nanoseconds step,
              const Expectation& expected_px,
              std::span<const geometry::Box2> without_px);
  // Looks for new points in the next cells without one, outside the boxes.
  void Seed(const image::LumaPyramid& pyramid,
            std::chrono::nanoseconds step,
            std::span<const geometry::Box2> without_px);
  // The same close together within `busy_px`.
  void SeedBusy(const image::LumaPyramid& pyramid,
                std::span<const geometry::Box2> busy_px,
                std::span<const geometry::Box2> without_px);
  // Forgets points that rest where an older one of their cell rests: they make
  // room where something may move.
  void Thin();
  // Just after Follow: forgets those of what moves that do not come back from
  // `now` to where they were in `before`.
  void ForgetUnreturned(const image::LumaPyramid& now,
                        const image::LumaPyramid& before);

  std::vector<FieldPoint>& points() { return points_; }
  const std::vector<FieldPoint>& points() const { return points_; }
  // 1 sigma of a followed point in the image, px.
  double sigma_px() const;

 private:
  struct Layout {
    cv::Size size_px;
    int level = 0;     // looked at
    int cell_px = 32;  // of that level
    cv::Size cells;
  };
  static Layout LayoutOf(const image::LumaPyramid& pyramid);
  void SeedRows(const image::LumaPyramid& pyramid,
                int rows,
                std::span<const geometry::Box2> without_px);
  void SeedBox(const image::LumaPyramid& pyramid,
               const geometry::Box2& box_px,
               std::span<const geometry::Box2> without_px);
  std::size_t CellOf(const Eigen::Vector2d& pixel_px) const;
  void Add(const Eigen::Vector2d& pixel_px);
  void ForgetCrowded();

  Layout layout_;
  std::vector<FieldPoint> points_;
  std::vector<cv::Point2d> before_px_;  // of points_, in the frame before
  std::uint64_t next_id_ = 1;
  int next_row_ = 0;
};

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_POINT_FIELD_H_
