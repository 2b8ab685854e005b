// SPDX-License-Identifier: Apache-2.0
#include "server/motion/constant_acceleration.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace groundlock::motion {
namespace {

using std::chrono::milliseconds;

GroundMeasurement At(double x, double y, double sigma_m = 0.02) {
  GroundMeasurement measurement;
  measurement.position_m = {x, y};
  measurement.covariance_m2 = sigma_m * sigma_m * Eigen::Matrix2d::Identity();
  return measurement;
}

TEST(Transition, StepsCompose) {
  const auto twice = (ConstantAccelerationTransition(0.3) *
                      ConstantAccelerationTransition(0.2))
                         .eval();
  EXPECT_LT((twice - ConstantAccelerationTransition(0.5)).norm(), 1e-12);
}

// Q(a + b) = A(b) Q(a) A(b)^T + Q(b): variable steps change nothing.
TEST(WhiteJerk, StepsCompose) {
  const auto A = ConstantAccelerationTransition(0.2);
  const auto sum =
      (A * WhiteJerkCovariance(0.3) * A.transpose() + WhiteJerkCovariance(0.2))
          .eval();
  EXPECT_LT((sum - WhiteJerkCovariance(0.5)).norm(), 1e-12);
}

TEST(ConstantAcceleration, FollowsUnevenSteps) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 0; i < 60; ++i) {
    t_ms += i % 3 == 0 ? 80 : 30;
    const double t = 1e-3 * t_ms;
    filter.Predict(milliseconds(t_ms));
    filter.Update(At(1.5 * t, 0.3 * t * t));
  }
  const double t = 1e-3 * t_ms;
  const GroundState state = filter.state();
  // Noiseless input of the filter's own model: the start is forgotten.
  EXPECT_NEAR(state.position_m.x(), 1.5 * t, 0.01);
  EXPECT_NEAR(state.velocity_m_s.x(), 1.5, 0.05);
  EXPECT_NEAR(state.acceleration_m_s2.y(), 0.6, 0.1);
}

TEST(ConstantAcceleration, MeasuredVelocityCounts) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  filter.Predict(milliseconds(40));
  GroundMeasurement measurement = At(0.04, 0.0);
  measurement.velocity_m_s = Eigen::Vector2d(1.0, 0.0);
  measurement.velocity_covariance_m2_s2 = 1e-6 * Eigen::Matrix2d::Identity();
  EXPECT_NEAR(filter.Update(measurement).velocity_m_s.x(), 1.0, 1e-3);
}

TEST(ConstantAcceleration, HiddenTargetKeepsItsWayAndDoesNotRunAway) {
  const MotionOptions options;
  ConstantAcceleration filter{options};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (; t_ms < 1000;) {
    t_ms += 40;
    filter.Predict(milliseconds(t_ms));
    filter.Update(At(1e-3 * t_ms, 0));
  }
  double trace = filter.state().position_covariance_m2.trace();
  for (int i = 0; i < 50; ++i) {
    t_ms += 40;
    filter.Predict(milliseconds(t_ms));
    EXPECT_GT(filter.state().position_covariance_m2.trace(), trace);
    trace = filter.state().position_covariance_m2.trace();
  }
  // Two seconds hidden, as in the occlusion experiment: 5 % of the way.
  EXPECT_NEAR(filter.state().position_m.x(), 3.0, 0.1);
  filter.Predict(milliseconds(t_ms + 60'000));
  EXPECT_LT(filter.state().position_m.x(),
            1.0 + 1.1 * (options.unseen_velocity_hold_s +
                         options.unseen_velocity_decay_s + 0.1));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(
      filter.state().position_covariance_m2);
  EXPECT_GT(eigen.eigenvalues().minCoeff(), 0.0);
}

TEST(ConstantAcceleration, StandingTargetStays) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  for (int i = 1; i <= 50; ++i) {
    filter.Predict(milliseconds(40 * i));
    filter.Update(At(i % 2 == 0 ? 0.02 : -0.02, 0));
  }
  const double x = filter.state().position_m.x();
  filter.Predict(milliseconds(40 * 51));
  filter.Predict(milliseconds(6000));
  EXPECT_NEAR(filter.state().position_m.x(), x, 0.03);
}

// Just before it is hidden, only its motion tells where it is, coarsely: its
// velocity is no longer significant then, but it was.
TEST(ConstantAcceleration, WhatWasSeenToMoveGoesOnAfterCoarseSightings) {
  MotionOptions options;
  options.target_size_m = 0.7;
  ConstantAcceleration filter{options};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 0; i < 60; ++i) {
    t_ms += 40;
    const double sigma_m = i < 48 ? 0.02 : 0.2;
    filter.Predict(milliseconds(t_ms));
    filter.Update(At(0.9e-3 * t_ms, 0.0, sigma_m));
  }
  const GroundState seen = filter.state();
  const Eigen::Vector2d v = seen.velocity_m_s;
  ASSERT_LT(v.dot(seen.velocity_covariance_m2_s2.inverse() * v),
            options.standing_gate);
  const GroundState later = filter.Predict(milliseconds(t_ms + 1'000));
  EXPECT_NEAR(later.velocity_m_s.x(), 0.9, 0.1);
}

// Five frames a second, and slowly: no velocity of the last half second is
// significant, but it has come a long way.
TEST(ConstantAcceleration, WhatHasComeALongWaySlowlyGoesOn) {
  for (const double speed_m_s : {0.0, 0.35}) {
    MotionOptions options;
    options.target_size_m = 0.7;
    ConstantAcceleration filter{options};
    filter.Initialize(milliseconds(0), At(0, 0));
    int t_ms = 0;
    for (int i = 0; i < 16; ++i) {
      t_ms += 200;
      filter.Predict(milliseconds(t_ms));
      filter.Update(At(1e-3 * speed_m_s * t_ms + (i % 2 == 0 ? 0.03 : -0.03),
                       0.0,
                       i < 13 ? 0.03 : 0.15));
    }
    const double seen_m = filter.state().position_m.x();
    filter.Predict(milliseconds(t_ms + 200));
    const GroundState later = filter.Predict(milliseconds(t_ms + 1'000));
    EXPECT_NEAR(later.position_m.x(), seen_m + speed_m_s, 0.1) << speed_m_s;
  }
}

// Seen once between two absences, it has come so far: that is its velocity,
// which one sighting alone does not tell.
TEST(ConstantAcceleration, TheWayOverAnAbsenceIsItsVelocity) {
  for (const double speed_m_s : {0.0, 0.9}) {
    MotionOptions options;
    options.target_size_m = 0.7;
    ConstantAcceleration filter{options};
    filter.Initialize(milliseconds(0), At(0, 0));
    int t_ms = 0;
    for (int i = 0; i < 30; ++i) {
      t_ms += 40;
      filter.Predict(milliseconds(t_ms));
      filter.Update(At(0.9e-3 * t_ms, 0.0, 0.03));
    }
    // It stops where it is hidden, or goes on.
    const double hidden_m = 0.9e-3 * t_ms;
    for (int i = 0; i < 50; ++i) {
      t_ms += 40;
      filter.Predict(milliseconds(t_ms));
    }
    const double seen_m = hidden_m + 2.0 * speed_m_s;
    filter.Update(At(seen_m, 0.0, 0.05));
    const GroundState later = [&] {
      filter.Predict(milliseconds(t_ms + 40));
      return filter.Predict(milliseconds(t_ms + 1'000));
    }();
    EXPECT_NEAR(later.position_m.x(), seen_m + speed_m_s, 0.15) << speed_m_s;
  }
}

// Two sightings with a missed frame between them tell less than the filter.
TEST(ConstantAcceleration, AMissedFrameIsNoAbsence) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 1; i <= 80; ++i) {
    t_ms += 40;
    filter.Predict(milliseconds(t_ms));
    const double off_m = i % 4 == 0 ? 0.03 : -0.03;
    if (i % 2 == 0) filter.Update(At(5e-3 * t_ms + off_m, 0.0, 0.03));
  }
  filter.Predict(milliseconds(t_ms + 40));
  const GroundState later = filter.Predict(milliseconds(t_ms + 200));
  EXPECT_NEAR(later.velocity_m_s.x(), 5.0, 0.25);
}

// A car that brakes has stopped, however fast it came.
TEST(ConstantAcceleration, WhatHasStoppedStays) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 0; i < 60; ++i) {
    t_ms += 40;
    const double x = i < 30 ? 1e-3 * t_ms : 1.2;
    filter.Predict(milliseconds(t_ms));
    filter.Update(At(x, 0.0));
  }
  const GroundState later = filter.Predict(milliseconds(t_ms + 2'000));
  EXPECT_NEAR(later.position_m.x(), 1.2, 0.02);
}

TEST(ConstantAcceleration, TimeThatStandsOrGoesBackPredictsNothing) {
  ConstantAcceleration filter{MotionOptions{}};
  filter.Initialize(milliseconds(100), At(1, 2));
  const GroundState before = filter.state();
  filter.Predict(milliseconds(100));
  filter.Predict(milliseconds(20));
  EXPECT_EQ(filter.state().position_covariance_m2,
            before.position_covariance_m2);
}

TEST(MotionOptions, NamesWhatIsWrong) {
  MotionOptions options;
  EXPECT_TRUE(CreateMotionPredictor(options).ok());
  options.name = "teleport";
  EXPECT_EQ(CreateMotionPredictor(options).status().code(),
            absl::StatusCode::kInvalidArgument);
  options = {};
  options.jerk_density = -1.0;
  EXPECT_NE(options.Validate().message().find("jerk_density"),
            absl::string_view::npos);
}

}  // namespace
}  // namespace groundlock::motion
