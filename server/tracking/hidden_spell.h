// SPDX-License-Identifier: Apache-2.0
// Since when something is said to hide a target, and whether that is believed.
#ifndef GROUNDLOCK_SERVER_TRACKING_HIDDEN_SPELL_H_
#define GROUNDLOCK_SERVER_TRACKING_HIDDEN_SPELL_H_

#include <chrono>
#include <optional>

namespace groundlock::tracking {

// Times are capture times, shares those of the target's outline. Not
// thread-safe.
class HiddenSpell {
 public:
  // The target is seen, while so much of it is said to be hidden, by other
  // targets and in all. Is it seen as a whole, as far as is known?
  //   is_back  it was not seen in the frame before.
  bool IsWhole(double by_targets,
               double share,
               bool is_back,
               std::chrono::nanoseconds time);
  // It was seen all the same for so long that it is not hidden: what the map
  // knows is gone, or can be seen through. Another target is neither.
  bool IsSeenInSpite(std::chrono::nanoseconds time) const;

  // The target is seen; it is not, while so much of it is said to be hidden.
  void NoteSeen() { vanished_behind_ = false; }
  void NoteUnseen(double hidden_share);
  // It went behind something after it was last seen, and may come out there.
  bool vanished_behind() const { return vanished_behind_; }

 private:
  friend struct StateFields;

  std::optional<std::chrono::nanoseconds> last_hidden_;  // a part, while seen
  // Since when it has been seen in spite of a part that is said to be hidden.
  std::optional<std::chrono::nanoseconds> seen_since_;
  bool vanished_behind_ = false;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_HIDDEN_SPELL_H_
