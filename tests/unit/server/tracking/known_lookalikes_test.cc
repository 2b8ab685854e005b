// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/known_lookalikes.h"

#include <gtest/gtest.h>

namespace groundlock::tracking {
namespace {

using Eigen::Vector2d;
using std::chrono::milliseconds;

TEST(KnownLookalikes, StandNearWhereTheyWereToldForAWhile) {
  KnownLookalikes known;
  EXPECT_FALSE(known.IsNear(Vector2d::Zero(), 1.0, milliseconds(0)));
  known.Add({1.0, 0.0}, milliseconds(0));
  known.Add({9.0, 0.0}, milliseconds(1'500));
  EXPECT_TRUE(known.IsNear({1.3, 0.0}, 0.5, milliseconds(1'600)));
  EXPECT_FALSE(known.IsNear({1.6, 0.0}, 0.5, milliseconds(1'600)));
  // The first one was told of too long ago.
  EXPECT_FALSE(known.IsNear({1.3, 0.0}, 0.5, milliseconds(2'100)));
  EXPECT_TRUE(known.IsNear({9.0, 0.3}, 0.5, milliseconds(2'100)));
}

}  // namespace
}  // namespace groundlock::tracking
