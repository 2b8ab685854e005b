// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/recent_outlines.h"

#include <gtest/gtest.h>

#include <chrono>
#include <limits>

namespace groundlock::tracking {
namespace {

using Eigen::Vector2d;
using geometry::Box2;
using ground::SeenOutline;
using namespace std::chrono_literals;

constexpr double kNoEnd = std::numeric_limits<double>::infinity();

// A body of 40 x 20 px about (100, 50) whose rear was not told from the road.
SeenOutline Outline(double front_px) {
  SeenOutline outline;
  outline.sure_px = {Vector2d(85.0, 41.0), Vector2d(115.0, 59.0)};
  outline.possible_px = {Vector2d(-kNoEnd, 40.0), Vector2d(front_px, 60.0)};
  outline.is_seen = {false, true, false, true};
  return outline;
}

TEST(RecentOutlines, ABoundThatIsFarOffMovesNothing) {
  RecentOutlines recent;
  const Vector2d center_px(100.0, 50.0);
  for (int i = 0; i < 20; ++i) {
    const SeenOutline seen = Outline(i % 5 == 3 ? 112.0 : 121.0);
    const SeenOutline steady = recent.Add(seen, center_px, 10.0, i * 100ms);
    EXPECT_NEAR(steady.possible_px.max_px.x(), 121.0, 1e-9) << i;
    EXPECT_EQ(steady.possible_px.min_px.x(), -kNoEnd);
    EXPECT_NEAR(steady.sure_px.min_px.x(), 85.0, 1e-9);
    EXPECT_NEAR(steady.sure_px.max_px.x(), 115.0, 1e-9);
  }
}

TEST(RecentOutlines, AnEdgeThatIsSeenIsWhereItIsSeen) {
  RecentOutlines recent;
  SeenOutline seen = Outline(121.0);
  for (int i = 0; i < 10; ++i) {
    recent.Add(seen, {100.0, 50.0}, 10.0, i * 100ms);
  }
  seen.possible_px.max_px.y() = seen.sure_px.max_px.y() = 66.0;
  const SeenOutline steady = recent.Add(seen, {100.0, 50.0}, 10.0, 1000ms);
  EXPECT_NEAR(steady.possible_px.max_px.y(), 66.0, 1e-9);
  EXPECT_NEAR(steady.sure_px.max_px.y(), 66.0, 1e-9);
}

// What is twice as near looks twice as large.
TEST(RecentOutlines, GoesWithTheTargetAndItsPoint) {
  RecentOutlines recent;
  for (int i = 0; i < 5; ++i) {
    recent.Add(Outline(121.0), {100.0, 50.0}, 10.0, i * 100ms);
  }
  // Its point is one 3 px to the right from here on.
  recent.Shift({3.0, 0.0});
  SeenOutline seen = Outline(112.0);
  const Vector2d center_px(306.0, 150.0);
  for (Box2* box_px : {&seen.sure_px, &seen.possible_px}) {
    box_px->min_px = center_px + 2.0 * (box_px->min_px - Vector2d(103.0, 50.0));
    box_px->max_px = center_px + 2.0 * (box_px->max_px - Vector2d(103.0, 50.0));
  }
  const SeenOutline steady = recent.Add(seen, center_px, 20.0, 500ms);
  EXPECT_NEAR(steady.possible_px.max_px.x(), 306.0 + 2.0 * 18.0, 1e-9);
  EXPECT_NEAR(steady.sure_px.min_px.x(), 306.0 - 2.0 * 18.0, 1e-9);
}

TEST(RecentOutlines, KnowsNothingOfAnotherTargetOrASecondBefore) {
  RecentOutlines recent;
  for (int i = 0; i < 10; ++i) {
    recent.Add(Outline(121.0), {100.0, 50.0}, 10.0, i * 100ms);
  }
  RecentOutlines forgets = recent;
  forgets.Forget();
  for (RecentOutlines* one : {&recent, &forgets}) {
    const SeenOutline steady =
        one->Add(Outline(112.0), {100.0, 50.0}, 10.0, 2500ms);
    EXPECT_NEAR(steady.possible_px.max_px.x(), 112.0, 1e-9);
  }
}

}  // namespace
}  // namespace groundlock::tracking
