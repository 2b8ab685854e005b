// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/other_targets.h"

#include <gtest/gtest.h>

#include <vector>

namespace groundlock::tracking {
namespace {

using geometry::Box2;

Box2 At(double x_px) { return Box2::FromXywh(x_px, 100, 40, 20); }

// Finding a target that may be anywhere within some 100 px.
constexpr double kVague = 1.6e-5;

TEST(OtherTargets, WhatIsFoundWhereAnotherIsSeenIsThatOne) {
  const OtherTargets others;
  const std::vector<SeenTarget> seen = {{"a", At(300)}, {"b", At(100)}};
  EXPECT_TRUE(others.IsTaken(At(102), kVague, seen));
  EXPECT_TRUE(others.IsTaken(At(102), std::nullopt, seen));
  EXPECT_FALSE(others.IsTaken(At(140), kVague, seen));
  EXPECT_FALSE(others.IsTaken(At(140), std::nullopt, seen));
  // One that is known to be just there passes the other one by.
  EXPECT_FALSE(others.IsTaken(At(102), 1.0, seen));
}

TEST(OtherTargets, ThoseThatAlwaysOverlapGoTogether) {
  OtherTargets others;
  const std::vector<SeenTarget> seen = {{"rider", At(105)}, {"b", At(130)}};
  EXPECT_FALSE(others.GoesWith("rider"));
  others.Note(At(100), seen);
  EXPECT_TRUE(others.GoesWith("rider"));
  EXPECT_FALSE(others.GoesWith("b"));
  EXPECT_FALSE(others.IsTaken(At(102), kVague, {seen.data(), 1}));
  // Beside each other once, they are two, wherever they meet.
  others.Note(At(200), seen);
  others.Note(At(100), seen);
  EXPECT_FALSE(others.GoesWith("rider"));
  EXPECT_TRUE(others.IsTaken(At(102), kVague, {seen.data(), 1}));
  // Another one of that name.
  others.Forget("rider");
  others.Note(At(100), seen);
  EXPECT_TRUE(others.GoesWith("rider"));
}

}  // namespace
}  // namespace groundlock::tracking
