// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/search_hypothesis.h"

#include <gtest/gtest.h>

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using Verdict = SearchHypothesis::Verdict;

constexpr SearchHypothesis::Bounds kBounds{.threshold = 0.5, .sure = 0.8};

// At `x_m` on the ground, where places are known to 0.1 m.
SearchHypothesis::Sight At(double x_m, double sureness, double least) {
  GroundSighting sighting;
  sighting.place_m = {x_m, 0.0};
  sighting.covariance_m2 = 0.01 * Eigen::Matrix2d::Identity();
  return {.box_px = Box2::FromXywh(100.0 * x_m, 0.0, 40.0, 30.0),
          .sureness = sureness,
          .least_sureness = least,
          .sighting = sighting};
}

TEST(SearchHypothesis, WhatIsSureIsBelievedWhereverItStands) {
  auto hypothesis = SearchHypothesis::Begin(At(0.0, 0.92, 0.3), kBounds);
  ASSERT_TRUE(hypothesis);
  EXPECT_TRUE(hypothesis->is_sure());
  EXPECT_EQ(hypothesis->See(At(0.0, 0.92, 0.3), kBounds), Verdict::kBelieved);
  hypothesis = SearchHypothesis::Begin(At(0.0, 0.82, 0.3), kBounds);
  ASSERT_TRUE(hypothesis);
  EXPECT_EQ(hypothesis->See(At(0.0, 0.82, 0.3), kBounds), Verdict::kOpen);
  EXPECT_EQ(hypothesis->See(At(0.0, 0.4, 0.3), kBounds), Verdict::kRefuted);
}

TEST(SearchHypothesis, WhatIsLessSureMustBeRecognisedEitherWay) {
  EXPECT_FALSE(SearchHypothesis::Begin(At(0.0, 0.7, 0.2), kBounds));
  auto hypothesis = SearchHypothesis::Begin(At(0.0, 0.7, 0.6), kBounds);
  ASSERT_TRUE(hypothesis);
  EXPECT_FALSE(hypothesis->is_sure());
  EXPECT_EQ(hypothesis->See(At(0.2, 0.7, 0.4), kBounds), Verdict::kRefuted);
}

TEST(SearchHypothesis, WhatIsLessSureIsBelievedOnceItGoesOverTheGround) {
  auto hypothesis = SearchHypothesis::Begin(At(0.0, 0.7, 0.67), kBounds);
  ASSERT_TRUE(hypothesis);
  int looks = 1;
  Verdict verdict = Verdict::kOpen;
  for (double x_m = 0.1; verdict == Verdict::kOpen; x_m += 0.1, ++looks) {
    verdict = hypothesis->See(At(x_m, 0.7, 0.67), kBounds);
  }
  EXPECT_EQ(verdict, Verdict::kBelieved);
  EXPECT_EQ(looks, 7);
  EXPECT_NEAR(hypothesis->box_px().x(), 60.0, 1e-9);
}

TEST(SearchHypothesis, WhatIsLessSureAndStaysIsSomethingOfTheMap) {
  auto hypothesis = SearchHypothesis::Begin(At(0.0, 0.79, 0.79), kBounds);
  ASSERT_TRUE(hypothesis);
  int looks = 1;
  Verdict verdict = Verdict::kOpen;
  for (; verdict == Verdict::kOpen; ++looks) {
    verdict = hypothesis->See(At(0.1, 0.79, 0.79), kBounds);
  }
  EXPECT_EQ(verdict, Verdict::kStoodStill);
  EXPECT_EQ(looks, 8);
  // Once it is sure, it need not move.
  hypothesis = SearchHypothesis::Begin(At(0.0, 0.79, 0.79), kBounds);
  EXPECT_EQ(hypothesis->See(At(0.0, 0.97, 0.79), kBounds), Verdict::kBelieved);
  EXPECT_TRUE(hypothesis->is_sure());
}

TEST(SearchHypothesis, WithoutPlacesNothingIsKnownToMove) {
  SearchHypothesis::Sight sight = At(0.0, 0.75, 0.75);
  sight.sighting.reset();
  auto hypothesis = SearchHypothesis::Begin(sight, kBounds);
  ASSERT_TRUE(hypothesis);
  Verdict verdict = Verdict::kOpen;
  while (verdict == Verdict::kOpen) verdict = hypothesis->See(sight, kBounds);
  EXPECT_EQ(verdict, Verdict::kStoodStill);
}

}  // namespace
}  // namespace groundlock::tracking
