// SPDX-License-Identifier: Apache-2.0
// One detection is never two targets.
#ifndef GROUNDLOCK_SERVER_TRACKING_OTHER_TARGETS_H_
#define GROUNDLOCK_SERVER_TRACKING_OTHER_TARGETS_H_

#include <map>
#include <optional>
#include <span>
#include <string>

#include "map_store/geometry/box.h"

namespace groundlock::tracking {

// Another target of the session, as it was seen in this frame or the last one.
struct SeenTarget {
  std::string id;
  geometry::Box2 box_px;
};

// What a target knows of the others: which of them are on the same thing (a
// rider and what is ridden, or one thing marked twice), and so whether what was
// found is rather one of the rest. Not thread-safe.
class OtherTargets {
 public:
  // The target was seen in `own_px`, and these others were: those that overlap
  // whenever both are seen go together.
  void Note(const geometry::Box2& own_px, std::span<const SeenTarget> seen);
  // The other one is gone; who has its name next is not the same.
  void Forget(const std::string& id) { goes_with_.erase(id); }
  bool GoesWith(const std::string& id) const;

  // Is what was found rather one of `seen`? Of two targets the one has it that
  // is likelier found there (SeenLikelihood).
  //   likelihood  the density, per square pixel, of finding this target there;
  //     nullopt: nothing says where it would be, and what overlaps another one
  //     is that one.
  bool IsTaken(const geometry::Box2& found_px,
               std::optional<double> likelihood,
               std::span<const SeenTarget> seen) const;

 private:
  friend struct StateFields;

  std::map<std::string, bool> goes_with_;  // of all that were ever seen with it
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_OTHER_TARGETS_H_
