// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/outline_scale.h"

#include <gtest/gtest.h>

#include <cmath>

namespace groundlock::tracking {
namespace {

constexpr double kStep_s = 0.1;

// How large the body is in the end, where the target looks as `log_ratio` says
// at each time.
template <typename Ratio>
double BodyAfter(OutlineScale& scale, double seconds, Ratio log_ratio) {
  double body = 1.0;
  for (double t_s = kStep_s; t_s < seconds; t_s += kStep_s) {
    scale.Predict(kStep_s);
    scale.Observe(log_ratio(t_s) - std::log(body));
    body *= scale.TakeBody();
  }
  return body;
}

TEST(OutlineScale, SaysWhatItStartsWith) {
  OutlineScale scale;
  EXPECT_NEAR(scale.ratio(), 1.0, 1e-12);
  scale.Restart(std::log(1.3));
  EXPECT_NEAR(scale.ratio(), 1.3, 0.01);
}

// On another stretch of a ground that is not where it is said to be.
TEST(OutlineScale, TheImageWinsWhereTheGroundIsWrong) {
  OutlineScale scale;
  const double body = BodyAfter(scale, 20.0, [](double t_s) {
    return t_s > 10.0 ? std::log(1.25) : 0.0;
  });
  EXPECT_NEAR(body * scale.ratio(), 1.25, 0.04);
  EXPECT_NEAR(body, 1.0, 0.08);
}

// Which was drawn too small: wherever it goes, it looks larger.
TEST(OutlineScale, WhatStaysIsTheBody) {
  OutlineScale scale;
  const double body =
      BodyAfter(scale, 60.0, [](double) { return std::log(1.2); });
  EXPECT_NEAR(body * scale.ratio(), 1.2, 0.04);
  EXPECT_GT(body, 1.1);
}

TEST(OutlineScale, UnseenItGoesBackToWhatTheGroundSays) {
  OutlineScale scale;
  const double body =
      BodyAfter(scale, 5.0, [](double) { return std::log(1.2); });
  const double seen = scale.ratio();
  EXPECT_NEAR(body * seen, 1.2, 0.05);
  for (int i = 0; i < 600; ++i) scale.Predict(kStep_s);
  EXPECT_NEAR(scale.ratio(), 1.0, 0.01);
}

}  // namespace
}  // namespace groundlock::tracking
