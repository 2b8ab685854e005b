// SPDX-License-Identifier: Apache-2.0
// The things that move, from key view to key view: where each is, how it goes,
// and whether it exists.
#ifndef GROUNDLOCK_SERVER_MOVERS_MOVER_LIST_H_
#define GROUNDLOCK_SERVER_MOVERS_MOVER_LIST_H_

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/movers/existence.h"

namespace groundlock::movers {

// A group of points of one key view, on the ground: axes of its reference
// plane.
struct Finding {
  geometry::Box2 box_px;
  Eigen::Vector2d place_m = Eigen::Vector2d::Zero();
  Eigen::Matrix2d place_covariance_m2 = Eigen::Matrix2d::Identity();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Identity();
  std::vector<std::uint64_t> point_ids;  // ascending
  double ground_per_image_m2_px2 = 1.0;  // area there
};

struct ListedMover {
  std::uint64_t id = 0;  // 0 until it is believed
  double existence = 0.0;
  geometry::Box2 box_px;  // in the key view in which it was last found
  Eigen::Vector4d state = Eigen::Vector4d::Zero();  // place m, velocity m/s
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Identity();
  std::vector<std::uint64_t> point_ids;
  // Where its place on the ground was in the image then.
  std::optional<Eigen::Vector2d> place_px;
  double unseen_s = 0.0;
  bool reported() const { return id != 0; }
};

// Not thread-safe.
class MoverList {
 public:
  explicit MoverList(const ExistenceModel& model) : model_(model) {}

  void Clear() { movers_.clear(); }
  // The next key view.
  //   step_s     since the one before.
  //   image_px2  its area, over which chance findings are spread.
  void Update(std::span<const Finding> findings,
              double step_s,
              double image_px2);
  // Forgets those whose box is mostly in one of these.
  void Forget(std::span<const geometry::Box2> boxes_px);
  // Notes where in the image those are that were found in this key view.
  void NotePlaces(const std::function<std::optional<Eigen::Vector2d>(
                      const Eigen::Vector2d& place_m)>& pixel_px);
  const std::vector<ListedMover>& movers() const { return movers_; }

 private:
  void Correct(ListedMover& mover, const Finding& finding, double image_px2);

  ExistenceModel model_;
  std::vector<ListedMover> movers_;
  std::uint64_t next_id_ = 1;
};

// Whether a box is where another one is: most of either lies in the other, or
// they overlap by a third.
bool IsSamePlace(const geometry::Box2& a_px, const geometry::Box2& b_px);

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_MOVER_LIST_H_
