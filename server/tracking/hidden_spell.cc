// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/hidden_spell.h"

namespace groundlock::tracking {
namespace {

// Of a target that is hidden by more than this share nothing is learnt.
constexpr double kLearnHidden = 0.1;
constexpr std::chrono::seconds kSeenInSpite{3};
// What hides a target reaches so far beyond what is known of it.
constexpr std::chrono::milliseconds kHiddenStill{250};
// A target out of sight that is expected to be hidden by so much went behind
// what hides it.
constexpr double kVanishes = 0.2;

}  // namespace

bool HiddenSpell::IsWhole(double by_targets,
                          double share,
                          bool is_back,
                          std::chrono::nanoseconds time) {
  if (is_back) {
    seen_since_.reset();
    last_hidden_.reset();
  }
  if (share >= kLearnHidden) {
    if (by_targets >= kLearnHidden) {
      seen_since_.reset();
    } else if (!seen_since_) {
      seen_since_ = time;
    }
    last_hidden_ = time;
  } else if (last_hidden_ && time - *last_hidden_ > kHiddenStill) {
    seen_since_.reset();
    last_hidden_.reset();
  }
  return !last_hidden_ || IsSeenInSpite(time);
}

bool HiddenSpell::IsSeenInSpite(std::chrono::nanoseconds time) const {
  return seen_since_ && time - *seen_since_ > kSeenInSpite;
}

void HiddenSpell::NoteUnseen(double hidden_share) {
  vanished_behind_ = vanished_behind_ || hidden_share >= kVanishes;
}

}  // namespace groundlock::tracking
