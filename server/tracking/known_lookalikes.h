// SPDX-License-Identifier: Apache-2.0
// What looks like a target, but is known to be something else.
#ifndef GROUNDLOCK_SERVER_TRACKING_KNOWN_LOOKALIKES_H_
#define GROUNDLOCK_SERVER_TRACKING_KNOWN_LOOKALIKES_H_

#include <Eigen/Core>
#include <chrono>
#include <vector>

namespace groundlock::tracking {

// They stand still. Places are on the ground, in metres or map units; times are
// capture times. Not thread-safe.
class KnownLookalikes {
 public:
  // For so long the best look does not always go to the same one, which would
  // leave the target unfound wherever else it is.
  static constexpr std::chrono::milliseconds kStays{2'000};

  void Add(const Eigen::Vector2d& place_m, std::chrono::nanoseconds time);
  // Was one told of no farther from there a moment ago?
  bool IsNear(const Eigen::Vector2d& place_m,
              double distance_m,
              std::chrono::nanoseconds time) const;

 private:
  friend struct StateFields;

  struct Lookalike {
    Eigen::Vector2d place_m = Eigen::Vector2d::Zero();
    std::chrono::nanoseconds told{0};
  };
  std::vector<Lookalike> known_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_KNOWN_LOOKALIKES_H_
