// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/known_lookalikes.h"

#include <algorithm>

namespace groundlock::tracking {

void KnownLookalikes::Add(const Eigen::Vector2d& place_m,
                          std::chrono::nanoseconds time) {
  std::erase_if(known_, [&](const Lookalike& known) {
    return time - known.told > kStays;
  });
  known_.push_back({place_m, time});
}

bool KnownLookalikes::IsNear(const Eigen::Vector2d& place_m,
                             double distance_m,
                             std::chrono::nanoseconds time) const {
  return std::any_of(known_.begin(), known_.end(), [&](const Lookalike& known) {
    return time - known.told <= kStays &&
           (place_m - known.place_m).norm() < distance_m;
  });
}

}  // namespace groundlock::tracking
