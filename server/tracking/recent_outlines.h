// SPDX-License-Identifier: Apache-2.0
// What the silhouettes of the last second have in common.
#ifndef GROUNDLOCK_SERVER_TRACKING_RECENT_OUTLINES_H_
#define GROUNDLOCK_SERVER_TRACKING_RECENT_OUTLINES_H_

#include <Eigen/Core>
#include <chrono>
#include <deque>

#include "server/ground/box_fit.h"

namespace groundlock::tracking {

// An edge that was not seen is a bound, and now and then one is far off: a dark
// cab before the dark road. Taken one by one, a body that is free to go on the
// other side gives way to each that is wrong and never comes back. So no bound
// says more than the median of those of the last second, about the point that
// is followed, which hardly goes astray in that time. Not thread-safe.
class RecentOutlines {
 public:
  // A silhouette was measured of a target that is followed at `center_px`;
  // returns it with bounds that most of those before it bear out.
  //   px_per_m  how large a metre looks there; anything that grows alike.
  ground::SeenOutline Add(const ground::SeenOutline& outline,
                          const Eigen::Vector2d& center_px,
                          double px_per_m,
                          std::chrono::nanoseconds time);
  // Of the same target another point is followed, so far from the other one.
  void Shift(const Eigen::Vector2d& by_px);
  // It is another target, or not known where the other point was.
  void Forget() { recent_.clear(); }

 private:
  friend struct StateFields;

  // How far its left, upper, right and lower edges are out from the point.
  struct Recent {
    Eigen::Vector4d sure_m = Eigen::Vector4d::Zero();
    Eigen::Vector4d possible_m = Eigen::Vector4d::Zero();
    double px_per_m = 1.0;
    std::chrono::nanoseconds time{0};
  };
  std::deque<Recent> recent_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_RECENT_OUTLINES_H_
