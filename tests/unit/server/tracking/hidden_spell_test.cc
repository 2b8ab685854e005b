// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/hidden_spell.h"

#include <gtest/gtest.h>

namespace groundlock::tracking {
namespace {

using std::chrono::milliseconds;

TEST(HiddenSpell, APartThatIsHiddenIsMissingAMomentLonger) {
  HiddenSpell spell;
  EXPECT_TRUE(spell.IsWhole(0.0, 0.0, true, milliseconds(0)));
  EXPECT_FALSE(spell.IsWhole(0.0, 0.5, false, milliseconds(40)));
  EXPECT_FALSE(spell.IsWhole(0.0, 0.0, false, milliseconds(200)));
  EXPECT_TRUE(spell.IsWhole(0.0, 0.0, false, milliseconds(300)));
}

TEST(HiddenSpell, WhatIsSeenInSpiteOfItForLongIsNotHidden) {
  HiddenSpell spell;
  for (int ms = 0; ms <= 3'000; ms += 40) {
    EXPECT_FALSE(spell.IsWhole(0.0, 0.5, ms == 0, milliseconds(ms))) << ms;
    EXPECT_FALSE(spell.IsSeenInSpite(milliseconds(ms))) << ms;
  }
  EXPECT_TRUE(spell.IsWhole(0.0, 0.5, false, milliseconds(3'040)));
  EXPECT_TRUE(spell.IsSeenInSpite(milliseconds(3'040)));
  // After an absence that counts no more.
  EXPECT_FALSE(spell.IsWhole(0.0, 0.5, true, milliseconds(4'000)));
  EXPECT_FALSE(spell.IsSeenInSpite(milliseconds(4'000)));
}

// Another target neither goes unnoticed nor can be seen through.
TEST(HiddenSpell, WhatAnotherTargetHidesStaysHidden) {
  HiddenSpell spell;
  for (int ms = 0; ms <= 6'000; ms += 40) {
    EXPECT_FALSE(spell.IsWhole(0.3, 0.3, ms == 0, milliseconds(ms))) << ms;
    EXPECT_FALSE(spell.IsSeenInSpite(milliseconds(ms))) << ms;
  }
  EXPECT_TRUE(spell.IsWhole(0.0, 0.0, false, milliseconds(6'300)));
}

TEST(HiddenSpell, WhatWentBehindSomethingIsBehindItUntilItIsSeen) {
  HiddenSpell spell;
  spell.NoteUnseen(0.1);
  EXPECT_FALSE(spell.vanished_behind());
  spell.NoteUnseen(0.5);
  spell.NoteUnseen(0.0);
  EXPECT_TRUE(spell.vanished_behind());
  spell.NoteSeen();
  EXPECT_FALSE(spell.vanished_behind());
}

}  // namespace
}  // namespace groundlock::tracking
