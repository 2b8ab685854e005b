// SPDX-License-Identifier: Apache-2.0
// Something that looks like a target where it was not expected: whether it is
// the target, frames in a row tell.
#ifndef GROUNDLOCK_SERVER_TRACKING_SEARCH_HYPOTHESIS_H_
#define GROUNDLOCK_SERVER_TRACKING_SEARCH_HYPOTHESIS_H_

#include <optional>

#include "map_store/geometry/box.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {

// A sequential probability ratio test (A. Wald, 1947). Not thread-safe.
class SearchHypothesis {
 public:
  // How it looks in one frame.
  struct Sight {
    geometry::Box2 box_px;
    // Probabilities that it is the target: by what tells it best and, of the
    // two ways to recognise it, by what tells it worst.
    double sureness = 0.0;
    double least_sureness = 0.0;
    std::optional<GroundSighting> sighting = std::nullopt;
  };
  // What a probability must be, in the frames that follow and once, to be sure.
  struct Bounds {
    double threshold = 0.5;
    double sure = 0.8;
  };
  // nullopt: it is not sure enough to be looked at again. Less than sure is so
  // what is recognised either way.
  static std::optional<SearchHypothesis> Begin(const Sight& sight,
                                               const Bounds& bounds);

  enum class Verdict {
    kOpen,
    kBelieved,
    kRefuted,
    // It was not sure, and stood where something that moves would have gone on.
    kStoodStill,
  };
  // The next frame. What is not sure must also go over the ground (chi-square,
  // 2 degrees, 99.9 %), as nothing does that the map has, within eight frames.
  Verdict See(const Sight& sight, const Bounds& bounds);

  bool is_sure() const { return is_sure_; }
  const geometry::Box2& box_px() const { return box_px_; }

 private:
  friend struct StateFields;

  SearchHypothesis() = default;

  geometry::Box2 box_px_;
  double evidence_ = 0.0;  // log-odds, summed over the frames
  bool is_sure_ = true;
  std::optional<GroundSighting> first_sighting_;
  bool has_moved_ = false;  // since then
  int looks_ = 1;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SEARCH_HYPOTHESIS_H_
