// SPDX-License-Identifier: Apache-2.0
// What a target looks like from which side.
#ifndef GROUNDLOCK_SERVER_TRACKING_VIEW_MEMORY_H_
#define GROUNDLOCK_SERVER_TRACKING_VIEW_MEMORY_H_

#include <chrono>
#include <memory>
#include <optional>
#include <vector>

#include "server/target/target_tracker.h"

namespace groundlock::tracking {

// One appearance for each of the sectors into which the angles of view are
// divided, kept however long the target is away: at most so many. Not
// thread-safe.
class ViewMemory {
 public:
  // `sectors` 0: remembers nothing.
  explicit ViewMemory(int sectors);

  // The target is surely seen from `view_rad` (any angle), and `tracker` has
  // learnt it. Kept is what was learnt as near to the sector's middle as the
  // view came in this visit.
  void Remember(double view_rad,
                std::chrono::nanoseconds time,
                const target::TargetTracker& tracker);

  // At most kRecalled appearances for one frame in which the target may be seen
  // from `view_rad`, and turned for the time that it was unseen: the nearest,
  // and the others in turn, frame by frame. Valid until the next Remember.
  //   view_rad  nullopt: not known.
  static constexpr int kRecalled = 2;
  std::vector<const target::Appearance*> Recall(
      std::optional<double> view_rad, std::chrono::nanoseconds unseen);
  // All of them, for a single look. Valid as long.
  std::vector<const target::Appearance*> All() const;

 private:
  friend struct StateFields;

  struct Sector {
    std::unique_ptr<target::Appearance> appearance;
    double view_rad = 0.0;      // where it was kept
    double off_middle_rad = 0;  // how far that is from the middle
    std::chrono::nanoseconds time{0};
  };

  double Middle_rad(int sector) const;

  std::vector<Sector> sectors_;
  int sector_ = -1;       // the last one remembered
  std::size_t turn_ = 0;  // of those that are recalled in turn
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_VIEW_MEMORY_H_
