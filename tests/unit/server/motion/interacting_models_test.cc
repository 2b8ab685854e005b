// SPDX-License-Identifier: Apache-2.0
#include "server/motion/interacting_models.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>

namespace groundlock::motion {
namespace {

using std::chrono::milliseconds;

GroundMeasurement At(double x, double y, double sigma_m = 0.02) {
  GroundMeasurement measurement;
  measurement.position_m = {x, y};
  measurement.covariance_m2 = sigma_m * sigma_m * Eigen::Matrix2d::Identity();
  return measurement;
}

// Whatever the turn rate, two steps lead where one of both does.
TEST(Curve, StepsCompose) {
  for (const double turn_rad_s : {0.0, 1e-5, 0.8, -3.0}) {
    CurveState start;
    start << 1.0, 2.0, 0.7, -0.4, turn_rad_s;
    // Of a turn rate that stays.
    constexpr double kStays_s = 1e12;
    const Curve once = GoAlongCurve(start, 0.5, kStays_s);
    const Curve first = GoAlongCurve(start, 0.3, kStays_s);
    const Curve second = GoAlongCurve(first.state, 0.2, kStays_s);
    EXPECT_LT((second.state - once.state).norm(), 1e-9) << turn_rad_s;
    EXPECT_LT((second.transition * first.transition - once.transition).norm(),
              1e-7)
        << turn_rad_s;
  }
}

TEST(Curve, TransitionIsItsDerivative) {
  for (const double turn_rad_s : {0.0, 2e-4, 0.9}) {
    CurveState start;
    start << 1.0, 2.0, 0.7, -0.4, turn_rad_s;
    const Curve curve = GoAlongCurve(start, 0.4, 3.0);
    for (int i = 0; i < 5; ++i) {
      const CurveState step = 1e-6 * CurveState::Unit(i);
      const CurveState slope = (GoAlongCurve(start + step, 0.4, 3.0).state -
                                GoAlongCurve(start - step, 0.4, 3.0).state) /
                               2e-6;
      EXPECT_LT((slope - curve.transition.col(i)).norm(), 1e-8) << i;
    }
  }
}

// The derivative has no step where the series takes over.
TEST(Curve, IsSmoothWhereItIsNearlyStraight) {
  CurveState start;
  start << 0.0, 0.0, 1.0, 0.0, 1e-3 / 0.05;
  CurveState less = start;
  start[4] *= 1.0 + 1e-9;
  less[4] *= 1.0 - 1e-9;
  const Curve above = GoAlongCurve(start, 0.05, 3.0);
  const Curve below = GoAlongCurve(less, 0.05, 3.0);
  EXPECT_LT((above.state - below.state).norm(), 1e-10);
  EXPECT_LT((above.transition - below.transition).norm(), 1e-10);
}

TEST(InteractingModels, FollowsUnevenSteps) {
  InteractingModels filter{MotionOptions{}};
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
  EXPECT_NEAR(state.position_m.x(), 1.5 * t, 0.01);
  EXPECT_NEAR(state.velocity_m_s.x(), 1.5, 0.1);
  EXPECT_NEAR(state.velocity_m_s.y(), 0.6 * t, 0.15);
}

TEST(InteractingModels, MeasuredVelocityCounts) {
  InteractingModels filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  filter.Predict(milliseconds(40));
  GroundMeasurement measurement = At(0.04, 0.0);
  measurement.velocity_m_s = Eigen::Vector2d(1.0, 0.0);
  measurement.velocity_covariance_m2_s2 = 1e-6 * Eigen::Matrix2d::Identity();
  EXPECT_NEAR(filter.Update(measurement).velocity_m_s.x(), 1.0, 1e-3);
}

TEST(InteractingModels, HiddenTargetKeepsItsWayAndDoesNotRunAway) {
  InteractingModels filter{MotionOptions{}};
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
  // Within a minute it has stopped now and then, and gone anywhere.
  filter.Predict(milliseconds(t_ms + 60'000));
  EXPECT_LT(filter.state().position_m.x(), 30.0);
  EXPECT_GT(filter.state().stands, 0.2);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(
      filter.state().position_covariance_m2);
  EXPECT_GT(eigen.eigenvalues().minCoeff(), 0.0);
}

TEST(InteractingModels, StandingTargetStays) {
  InteractingModels filter{MotionOptions{}};
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
TEST(InteractingModels, WhatWasSeenToMoveGoesOnAfterCoarseSightings) {
  MotionOptions options;
  options.target_size_m = 0.7;
  InteractingModels filter{options};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 0; i < 60; ++i) {
    t_ms += 40;
    const double sigma_m = i < 48 ? 0.02 : 0.2;
    filter.Predict(milliseconds(t_ms));
    filter.Update(At(0.9e-3 * t_ms, 0.0, sigma_m));
  }
  const GroundState seen = filter.state();
  EXPECT_LT(seen.stands, 0.1);
  const GroundState later = filter.Predict(milliseconds(t_ms + 1'000));
  EXPECT_NEAR(later.velocity_m_s.x(), 0.9, 0.1);
}

// Five frames a second, and slowly: no velocity of the last half second is
// significant, but it has come a long way.
TEST(InteractingModels, WhatHasComeALongWaySlowlyGoesOn) {
  for (const double speed_m_s : {0.0, 0.35}) {
    MotionOptions options;
    options.target_size_m = 0.7;
    InteractingModels filter{options};
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
TEST(InteractingModels, TheWayOverAnAbsenceIsItsVelocity) {
  for (const double speed_m_s : {0.0, 0.9}) {
    MotionOptions options;
    options.target_size_m = 0.7;
    InteractingModels filter{options};
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
TEST(InteractingModels, AMissedFrameIsNoAbsence) {
  InteractingModels filter{MotionOptions{}};
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
TEST(InteractingModels, WhatHasStoppedStays) {
  InteractingModels filter{MotionOptions{}};
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

TEST(InteractingModels, TimeThatStandsOrGoesBackPredictsNothing) {
  InteractingModels filter{MotionOptions{}};
  filter.Initialize(milliseconds(100), At(1, 2));
  const GroundState before = filter.state();
  filter.Predict(milliseconds(100));
  filter.Predict(milliseconds(20));
  EXPECT_EQ(filter.state().position_covariance_m2,
            before.position_covariance_m2);
}

// It was on a bend when it was hidden, and is on it two seconds later.
TEST(InteractingModels, HiddenTargetGoesOnRoundItsBend) {
  constexpr double kRadius_m = 0.8;
  constexpr double kTurn_rad_s = 0.8;
  const auto at = [&](int t_ms) {
    const double a = kTurn_rad_s * 1e-3 * t_ms;
    return Eigen::Vector2d(kRadius_m * std::sin(a),
                           kRadius_m * (1.0 - std::cos(a)));
  };
  MotionOptions options;
  options.target_size_m = 0.7;
  InteractingModels filter{options};
  filter.Initialize(milliseconds(0), At(0, 0));
  int t_ms = 0;
  for (int i = 1; i <= 75; ++i) {
    t_ms += 40;
    filter.Predict(milliseconds(t_ms));
    const double off_m = i % 2 == 0 ? 0.02 : -0.02;
    filter.Update(At(at(t_ms).x() + off_m, at(t_ms).y() - off_m));
  }
  EXPECT_NEAR(filter.state().turn_rad_s, kTurn_rad_s, 0.15);
  const GroundState later = filter.Predict(milliseconds(t_ms + 2'000));
  // Straight on it would be 0.9 m off.
  const Eigen::Vector2d off_m = later.position_m - at(t_ms + 2'000);
  EXPECT_LT(off_m.norm(), 0.3);
  EXPECT_LT(off_m.dot(later.position_covariance_m2.inverse() * off_m), 6.0);
}

// It stood at once: no speed is to be seen, and its place does not spread.
TEST(InteractingModels, WhatStandsStaysWhereItIs) {
  InteractingModels filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  for (int i = 1; i <= 25; ++i) {
    filter.Predict(milliseconds(40 * i));
    filter.Update(At(i % 2 == 0 ? 0.02 : -0.02, 0));
  }
  EXPECT_GT(filter.state().stands, 0.9);
  const GroundState later = filter.Predict(milliseconds(3'000));
  EXPECT_GT(later.stands, 0.5);
  EXPECT_LT(later.position_m.norm(), 0.05);
}

// Of what is on its way all models foresee nearly the same, which is a
// Gaussian.
TEST(InteractingModels, SurpriseIsTheMahalanobisDistanceOfOneGaussian) {
  InteractingModels filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  for (int i = 1; i <= 50; ++i) {
    filter.Predict(milliseconds(40 * i));
    filter.Update(At(0.04 * i, 0));
  }
  const GroundState state = filter.state();
  const Eigen::Matrix2d R = 0.04 * Eigen::Matrix2d::Identity();
  for (const double off_m : {0.0, 0.2, 0.6}) {
    const Eigen::Vector2d off(off_m, -off_m);
    EXPECT_NEAR(filter.Surprise(state.position_m + off, R),
                off.dot((state.position_covariance_m2 + R).inverse() * off),
                0.1)
        << off_m;
  }
}

// It stood, and half a second later it may have started: less of a surprise
// than the covariance says, while far off is as much of one as ever.
TEST(InteractingModels, WhatStoodMayHaveStarted) {
  InteractingModels filter{MotionOptions{}};
  filter.Initialize(milliseconds(0), At(0, 0));
  for (int i = 1; i <= 50; ++i) {
    filter.Predict(milliseconds(40 * i));
    filter.Update(At(0, 0));
  }
  const GroundState later = filter.Predict(milliseconds(2'500));
  const Eigen::Matrix2d R = 1e-3 * Eigen::Matrix2d::Identity();
  const Eigen::Vector2d started(0.35, 0.0);
  const double gaussian =
      started.dot((later.position_covariance_m2 + R).inverse() * started);
  EXPECT_GT(gaussian, 13.8);
  EXPECT_LT(filter.Surprise(started, R), 13.8);
  EXPECT_GT(filter.Surprise(4.0 * started, R), 13.8);
  EXPECT_EQ(filter.Surprise({0.0, 0.0}, R), 0.0);
}

// A measured velocity tells which of them it is.
TEST(InteractingModels, VelocityAtTheStartTellsTheModel) {
  for (const double speed_m_s : {0.0, 1.0}) {
    InteractingModels filter{MotionOptions{}};
    GroundMeasurement start = At(0, 0);
    start.velocity_m_s = Eigen::Vector2d(speed_m_s, 0.0);
    start.velocity_covariance_m2_s2 = 0.01 * Eigen::Matrix2d::Identity();
    filter.Initialize(milliseconds(0), start);
    EXPECT_NEAR(filter.state().stands, speed_m_s > 0.0 ? 0.0 : 1.0, 0.1);
    EXPECT_NEAR(filter.state().velocity_m_s.x(), speed_m_s, 0.05);
  }
}

TEST(MotionOptions, NamesWhatIsWrong) {
  MotionOptions options;
  EXPECT_TRUE(CreateMotionPredictor(options).ok());
  options.name = "teleport";
  EXPECT_EQ(CreateMotionPredictor(options).status().code(),
            absl::StatusCode::kInvalidArgument);
  options = {};
  options.turn_time_s = -1.0;
  EXPECT_NE(options.Validate().message().find("turn_time_s"),
            absl::string_view::npos);
}

}  // namespace
}  // namespace groundlock::motion
