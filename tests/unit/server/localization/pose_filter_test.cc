// SPDX-License-Identifier: Apache-2.0
#include "server/localization/window/pose_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeWorldFromCamera;

constexpr nanoseconds kStep = milliseconds(40);

// 1.2 m/s and 0.5 rad/s, about directions of its own.
Rigid3 PoseAt(nanoseconds time) {
  const double t_s = std::chrono::duration<double>(time).count();
  Vector6d motion;
  motion << 1.0 * t_s, -0.6 * t_s, 0.3 * t_s, 0.1 * t_s, -0.2 * t_s, 0.45 * t_s;
  return MovePose(MakeWorldFromCamera(), motion);
}

// Of what is followed: as much as an ordinary frame says.
constexpr double kOrdinary = 40.0;
constexpr double kWhateverItTakes = 1e9;

// A millimetre and a milliradian.
Matrix6d Sharp() { return 1e-6 * Matrix6d::Identity(); }

MapMeasurement FromMap(const Rigid3& pose,
                       const Matrix6d& random = Sharp(),
                       const Matrix6d& systematic = Matrix6d::Zero(),
                       double shared = 0.0) {
  return {pose, random, systematic, shared};
}

PoseFilter Moving(int frames) {
  PoseFilter filter{PoseFilterOptions()};
  filter.Start(nanoseconds(0), FromMap(PoseAt(nanoseconds(0))));
  for (int i = 1; i <= frames; ++i) {
    filter.Propagate(i * kStep);
    EXPECT_TRUE(filter.UpdateFromMap(FromMap(PoseAt(i * kStep))));
  }
  return filter;
}

double Nees(const PoseEstimate& estimate, const Rigid3& truth) {
  const Vector6d error = PoseDifference(estimate.world_from_camera, truth);
  return error.dot(estimate.covariance.ldlt().solve(error));
}

TEST(PoseFilter, ConstantVelocityIsPredicted) {
  PoseFilter filter = Moving(100);
  for (const int ahead : {0, 1, 3, 6}) {
    const nanoseconds time = (100 + ahead) * kStep;
    filter.Propagate(time);
    const Rigid3 pose = filter.pose().world_from_camera;
    EXPECT_LT(CenterError(pose, PoseAt(time)), 1e-5);
    EXPECT_LT(AngleError_rad(pose, PoseAt(time)), 1e-5);
  }
}

TEST(PoseFilter, UnseenItCoastsThenComesToRestAndGrowsUncertain) {
  PoseFilter filter = Moving(50);
  const nanoseconds end = 50 * kStep;
  filter.Propagate(end + milliseconds(200));
  EXPECT_LT(CenterError(filter.pose().world_from_camera,
                        PoseAt(end + milliseconds(200))),
            1e-4);
  double before = filter.pose().covariance(0, 0);
  for (int i = 1; i <= 50; ++i) {
    filter.Propagate(end + milliseconds(200) + i * kStep);
    EXPECT_GT(filter.pose().covariance(0, 0), before);
    before = filter.pose().covariance(0, 0);
  }
  // 1.2 m/s for a quarter of a second, then a time constant's worth.
  const Rigid3 rest = filter.pose().world_from_camera;
  EXPECT_NEAR(CenterError(rest, PoseAt(end)), 1.2 * 0.5, 0.12);
  filter.Propagate(end + std::chrono::seconds(4));
  EXPECT_LT(CenterError(filter.pose().world_from_camera, rest), 0.01);
}

TEST(PoseFilter, LearnsAGyroscopesBiasAndTurnsByIt) {
  PoseFilterOptions options;
  options.imu.emplace();
  PoseFilter filter(options);
  PoseFilter blind(PoseFilterOptions{});
  const Eigen::Vector3d bias(0.04, -0.03, 0.06);
  const auto start = FromMap(PoseAt(nanoseconds(0)));
  filter.Start(nanoseconds(0), start);
  blind.Start(nanoseconds(0), start);
  // From frame 60 on, it turns as nobody expects.
  const auto pose = [](int frame) {
    Vector6d motion = Vector6d::Zero();
    motion(4) = 0.03 * std::max(0, frame - 60);
    return MovePose(PoseAt(frame * kStep), motion);
  };
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0.0, 1.2e-4 * std::sqrt(200.0));
  for (int i = 1; i <= 75; ++i) {
    filter.Remember(PoseFilter::kLastFrame);
    filter.Propagate(i * kStep);
    blind.Propagate(i * kStep);
    const Eigen::Vector3d turned = geometry::RotationVector(
        pose(i - 1).rotation.conjugate() * pose(i).rotation);
    Gyroscope gyroscope(*options.imu);
    std::vector<InertialSample> samples;
    for (int k = 0; k <= 8; ++k) {
      samples.push_back(
          {(i - 1) * kStep + k * milliseconds(5),
           turned / 0.04 + bias +
               Eigen::Vector3d(noise(random), noise(random), noise(random)),
           {}});
    }
    gyroscope.Add(samples);
    const auto turn = gyroscope.Between(
        (i - 1) * kStep, i * kStep, filter.gyroscope_bias_rad_s());
    ASSERT_TRUE(turn);
    filter.UpdateFromGyroscope(PoseFilter::kLastFrame, *turn);
    if (i > 60) continue;
    ASSERT_TRUE(filter.UpdateFromMap(FromMap(pose(i))));
    ASSERT_TRUE(blind.UpdateFromMap(FromMap(pose(i))));
  }
  EXPECT_LT((filter.gyroscope_bias_rad_s() - bias).norm(), 5e-3);
  const double with = AngleError_rad(filter.pose().world_from_camera, pose(75));
  EXPECT_GT(AngleError_rad(blind.pose().world_from_camera, pose(75)), 0.3);
  EXPECT_LT(with, 0.01);
  // What is learnt outlives a new start.
  const Eigen::Vector3d learnt = filter.gyroscope_bias_rad_s();
  filter.Start(75 * kStep, FromMap(pose(75)));
  EXPECT_EQ(filter.gyroscope_bias_rad_s(), learnt);
}

TEST(PoseFilter, TimeDoesNotRunBackwards) {
  PoseFilter filter = Moving(5);
  const PoseEstimate before = filter.pose();
  filter.Propagate(nanoseconds(0));
  EXPECT_EQ(filter.time(), 5 * kStep);
  EXPECT_EQ(filter.pose().covariance, before.covariance);
  EXPECT_EQ(filter.pose().world_from_camera.translation,
            before.world_from_camera.translation);
}

TEST(PoseFilter, AWeakDirectionIsHeldByTheMotion) {
  PoseFilter filter = Moving(50);
  Matrix6d weak = Sharp();
  weak(1, 1) = 0.05 * 0.05;
  for (int i = 51; i <= 60; ++i) {
    const double side = i % 2 == 0 ? 1.0 : -1.0;
    Rigid3 measured = PoseAt(i * kStep);
    measured.translation.y() += 0.03 * side;
    filter.Propagate(i * kStep);
    ASSERT_TRUE(filter.UpdateFromMap(FromMap(measured, weak)));
    EXPECT_LT(std::abs(filter.pose().world_from_camera.translation.y() -
                       PoseAt(i * kStep).translation.y()),
              0.012);
    EXPECT_LT(filter.pose().covariance(1, 1), 0.5 * weak(1, 1));
    EXPECT_GT(filter.pose().covariance(1, 1), filter.pose().covariance(0, 0));
  }
}

// What a relative measurement refers to is corrected later: so is the pose now.
TEST(PoseFilter, AnEarlierFramesCorrectionReachesThePoseNow) {
  PoseFilter filter{PoseFilterOptions()};
  // Known to 10 cm and 0.03 rad, and off by as much.
  Matrix6d rough = 1e-2 * Matrix6d::Identity();
  rough.bottomRightCorner<3, 3>() *= 0.1;
  Vector6d off;
  off << 0.1, -0.05, 0.08, 0.03, -0.02, 0.01;
  const Rigid3 wrong = MovePose(PoseAt(nanoseconds(0)), off);
  filter.Start(nanoseconds(0), FromMap(wrong, rough));
  filter.Remember(PoseFilter::kKeyFrame);
  filter.Remember(PoseFilter::kAnchorFrame);
  for (int i = 1; i <= 10; ++i) {
    filter.Propagate(i * kStep);
    const Rigid3 seen =
        wrong * PoseAt(nanoseconds(0)).Inverse() * PoseAt(i * kStep);
    ASSERT_TRUE(filter.UpdateRelative(
        PoseFilter::kKeyFrame, wrong, {seen, Sharp()}, kOrdinary));
  }
  const double before =
      CenterError(filter.pose().world_from_camera, PoseAt(10 * kStep));
  EXPECT_GT(before, 0.05);
  ASSERT_TRUE(filter.UpdateFromMap(PoseFilter::kAnchorFrame,
                                   FromMap(PoseAt(nanoseconds(0)))));
  EXPECT_LT(CenterError(filter.pose().world_from_camera, PoseAt(10 * kStep)),
            0.1 * before);
  EXPECT_LT(filter.pose().covariance(0, 0), 1e-4);
  filter.MakeAnchorFrameKeyFrame();
  EXPECT_FALSE(filter.Remembers(PoseFilter::kAnchorFrame));
  EXPECT_LT(CenterError(filter.pose(PoseFilter::kKeyFrame).world_from_camera,
                        PoseAt(nanoseconds(0))),
            0.01);
}

TEST(PoseFilter, ContradictionsAreToldAndChangeNothing) {
  PoseFilter filter = Moving(50);
  filter.Remember(PoseFilter::kKeyFrame);
  filter.Propagate(51 * kStep);
  const PoseEstimate before = filter.pose();
  Rigid3 elsewhere = PoseAt(51 * kStep);
  elsewhere.translation.z() += 0.5;
  EXPECT_FALSE(filter.UpdateFromMap(FromMap(elsewhere)));
  EXPECT_FALSE(filter.UpdateRelative(
      PoseFilter::kKeyFrame, PoseAt(50 * kStep), {elsewhere, Sharp()}, 20.0));
  EXPECT_EQ(filter.pose().world_from_camera.translation,
            before.world_from_camera.translation);

  filter.Remember(PoseFilter::kAnchorFrame);
  filter.Propagate(52 * kStep);
  const Rigid3 correction = elsewhere * PoseAt(51 * kStep).Inverse();
  filter.RestartFromMap(PoseFilter::kAnchorFrame, FromMap(elsewhere));
  EXPECT_LT(CenterError(filter.pose().world_from_camera,
                        correction * PoseAt(52 * kStep)),
            1e-3);
  // The other frame lies to that of the anchor as before.
  ASSERT_TRUE(filter.Remembers(PoseFilter::kKeyFrame));
  EXPECT_LT(CenterError(filter.pose(PoseFilter::kKeyFrame).world_from_camera,
                        correction * PoseAt(50 * kStep)),
            1e-3);
  // As uncertain as the measurement, and as one step of a velocity that the
  // last two measurements tell.
  EXPECT_GT(filter.pose().covariance(0, 0), 1e-6);
  EXPECT_LT(filter.pose().covariance(0, 0), 0.01 * 0.01);
}

TEST(PoseFilter, TellsHowFarTheCameraMayHaveMovedSinceAFrame) {
  PoseFilter filter = Moving(50);
  filter.Remember(PoseFilter::kKeyFrame);
  EXPECT_LT(filter.RelativeCovariance(PoseFilter::kKeyFrame).norm(), 1e-12);
  EXPECT_GT(filter.pose().covariance.norm(), 1e-6);
  filter.Propagate(51 * kStep);
  const auto one = filter.RelativeCovariance(PoseFilter::kKeyFrame);
  filter.Propagate(52 * kStep);
  const auto two = filter.RelativeCovariance(PoseFilter::kKeyFrame);
  for (int i = 0; i < 6; ++i) {
    EXPECT_GT(one(i, i), 0.0);
    EXPECT_GT(two(i, i), 2.0 * one(i, i));
  }
}

// What is followed from a frame that a contradicting anchor has moved is known
// as well as that anchor, and no better.
TEST(PoseFilter, AfterARestartTheOtherFramesAreAsUncertainAsTheAnchor) {
  PoseFilter filter = Moving(50);
  filter.Remember(PoseFilter::kAnchorFrame);
  for (int i = 51; i <= 70; ++i) {
    filter.Propagate(i * kStep);
    ASSERT_TRUE(filter.UpdateRelative(PoseFilter::kAnchorFrame,
                                      PoseAt(50 * kStep),
                                      {PoseAt(i * kStep), Sharp()},
                                      kOrdinary));
    if (i == 60) filter.Remember(PoseFilter::kKeyFrame);
  }
  Rigid3 elsewhere = PoseAt(50 * kStep);
  elsewhere.translation.z() += 0.5;
  const Matrix6d rough = 4e-4 * Matrix6d::Identity();
  const auto relative = filter.RelativeCovariance(PoseFilter::kKeyFrame).eval();
  filter.RestartFromMap(PoseFilter::kAnchorFrame, FromMap(elsewhere, rough));
  const PoseEstimate anchor = filter.pose(PoseFilter::kAnchorFrame);
  EXPECT_LT(CenterError(anchor.world_from_camera, elsewhere), 1e-12);
  EXPECT_LT((anchor.covariance - rough).norm(), 1e-12);
  const PoseEstimate key = filter.pose(PoseFilter::kKeyFrame);
  const Rigid3 correction = elsewhere * PoseAt(50 * kStep).Inverse();
  EXPECT_LT(CenterError(key.world_from_camera, correction * PoseAt(60 * kStep)),
            2e-3);
  EXPECT_GT(key.covariance(0, 0), rough(0, 0));
  EXPECT_LT(key.covariance(0, 0), 2.0 * rough(0, 0));
  EXPECT_LT(
      (filter.RelativeCovariance(PoseFilter::kKeyFrame) - relative).norm(),
      1e-3 * relative.norm());
  // A second opinion in the key frame is a measurement like any other.
  EXPECT_TRUE(filter.UpdateFromMap(
      PoseFilter::kKeyFrame, FromMap(correction * PoseAt(60 * kStep), rough)));
}

TEST(PoseFilter, AJoltIsTakenInWhereEnoughSpeaksForIt) {
  PoseFilter filter = Moving(50);
  filter.Remember(PoseFilter::kKeyFrame);
  filter.Propagate(51 * kStep);
  // Ten centimetres and five degrees more than expected, in a frame: some 40
  // standard deviations. A Gaussian has exp(-800) of that, this has exp(-30).
  Vector6d jolt;
  jolt << 0.1, 0.0, 0.0, 0.0, 0.0, 0.09;
  const Rigid3 pose = MovePose(PoseAt(51 * kStep), jolt);
  const PoseEstimate measured{pose, Sharp()};
  EXPECT_FALSE(filter.UpdateRelative(
      PoseFilter::kKeyFrame, PoseAt(50 * kStep), measured, 15.0));
  EXPECT_TRUE(filter.UpdateRelative(
      PoseFilter::kKeyFrame, PoseAt(50 * kStep), measured, 60.0));
  EXPECT_LT(CenterError(filter.pose().world_from_camera, pose), 0.005);
}

TEST(PoseFilter, WhatNothingSpeaksForChangesNothing) {
  PoseFilter filter = Moving(50);
  filter.Remember(PoseFilter::kKeyFrame);
  filter.Propagate(51 * kStep);
  Vector6d leap;
  leap << 5.0, 0.0, 0.0, 0.0, 0.0, 0.0;
  const PoseEstimate measured{MovePose(PoseAt(51 * kStep), leap), Sharp()};
  const PoseEstimate before = filter.pose();
  const auto relative = filter.RelativeCovariance(PoseFilter::kKeyFrame).eval();
  for (int i = 0; i < 3; ++i) {
    EXPECT_FALSE(filter.UpdateRelative(
        PoseFilter::kKeyFrame, PoseAt(50 * kStep), measured, kOrdinary));
  }
  EXPECT_EQ(filter.pose().covariance, before.covariance);
  EXPECT_EQ(filter.pose().world_from_camera.translation,
            before.world_from_camera.translation);
  EXPECT_EQ(filter.RelativeCovariance(PoseFilter::kKeyFrame), relative);
}

// A camera that is pushed every second: what the filter then says of its pose
// and velocity is as honest as between the pushes.
TEST(PoseFilter, IsHonestWhenItIsPushed) {
  constexpr int kFrames = 2'000;
  std::mt19937_64 engine(11);
  std::normal_distribution<double> normal;
  const auto draw = [&](double sigma) {
    Vector6d v;
    for (int i = 0; i < 6; ++i) v[i] = sigma * normal(engine);
    return v;
  };
  const PoseFilterOptions options;
  PoseFilter filter(options);
  Rigid3 truth = MakeWorldFromCamera();
  Vector6d velocity_s = Vector6d::Zero();
  filter.Start(nanoseconds(0), FromMap(truth));
  const double step_s = 0.04;
  const double kick_s = std::sqrt(options.acceleration_lasts_s * step_s);
  double pushed = 0.0;
  double after = 0.0;
  int pushes = 0;
  for (int i = 1; i <= kFrames; ++i) {
    const double strength = i % 25 == 0 ? 12.0 : 1.0;
    Vector6d acceleration = draw(strength);
    acceleration.head<3>() *= options.acceleration_s2 * kick_s;
    acceleration.tail<3>() *= options.angular_acceleration_rad_s2 * kick_s;
    const Vector6d before_s = velocity_s;
    velocity_s += acceleration;
    // Hands pull back what they have pushed.
    velocity_s *= 0.9;
    const Rigid3 before = truth;
    truth = MovePose(truth, 0.5 * step_s * (before_s + velocity_s));
    filter.Remember(PoseFilter::kKeyFrame);
    filter.Propagate(i * kStep);
    const PoseEstimate measured{MovePose(truth, draw(1e-3)), Sharp()};
    ASSERT_TRUE(filter.UpdateRelative(
        PoseFilter::kKeyFrame, before, measured, kWhateverItTakes));
    ASSERT_TRUE(filter.UpdateFromMap(FromMap(MovePose(truth, draw(1e-3)))));
    if (i % 25 == 0) {
      pushed += Nees(filter.pose(), truth);
      ++pushes;
    } else if (i % 25 == 1) {
      after += Nees(filter.pose(), truth);
    }
  }
  // Of six dimensions; eighty pushes leave 0.4.
  EXPECT_NEAR(pushed / pushes, 6.0, 0.3 * 6.0);
  EXPECT_NEAR(after / pushes, 6.0, 0.3 * 6.0);
}

// The map is not seen for two seconds, as long as a pose is held; the arm to
// the antenna is half a metre.
TEST(PoseFilter, OtherSensorsSteerThePoseWhereNothingIsSeen) {
  const Eigen::Vector3d arm(0.3, -0.4, 0.1);
  const Eigen::Vector3d error(0.12, -0.2, 0.15);
  const Eigen::Quaterniond turned =
      geometry::QuaternionFromRotationVector({0.02, -0.01, 0.03});
  const auto tell = [&](PoseFilter& filter, nanoseconds time) {
    const Rigid3 truth = PoseAt(time);
    EXPECT_TRUE(filter.UpdateFromPosition(
        {truth.translation + truth.rotation * arm + error, 0.2, arm}));
    EXPECT_TRUE(filter.UpdateFromAttitude({turned * truth.rotation, 0.03}));
  };
  PoseFilter told = Moving(3);
  PoseFilter blind = told;
  for (int i = 4; i <= 50; ++i) {
    for (PoseFilter* filter : {&told, &blind}) {
      filter->Propagate(i * kStep);
      ASSERT_TRUE(filter->UpdateFromMap(FromMap(PoseAt(i * kStep))));
    }
    tell(told, i * kStep);
  }
  // Beside the map they say nothing.
  EXPECT_LT(CenterError(told.pose().world_from_camera, PoseAt(50 * kStep)),
            1e-3);
  for (int i = 51; i <= 100; ++i) {
    told.Propagate(i * kStep);
    blind.Propagate(i * kStep);
    tell(told, i * kStep);
  }
  const Rigid3 truth = PoseAt(100 * kStep);
  EXPECT_GT(CenterError(blind.pose().world_from_camera, truth), 1.0);
  // What they err was learnt while the map was seen: it is 0.28 m and 2
  // degrees.
  EXPECT_LT(CenterError(told.pose().world_from_camera, truth), 0.1);
  EXPECT_LT(AngleError_rad(told.pose().world_from_camera, truth), 0.015);
  EXPECT_LT(Nees(told.pose(), truth), 3.0 * 6.0);
  EXPECT_GT(told.pose().covariance(0, 0), 1e-4);

  // Wrong ones are told by what is known, and change nothing.
  const PoseEstimate before = told.pose();
  EXPECT_FALSE(told.UpdateFromPosition(
      {truth.translation + Eigen::Vector3d(0.0, 5.0, 0.0), 0.2, arm}));
  EXPECT_FALSE(told.UpdateFromAttitude(
      {geometry::QuaternionFromRotationVector({0.0, 0.0, 0.8}) * truth.rotation,
       0.03}));
  EXPECT_EQ(told.pose().covariance, before.covariance);
  EXPECT_EQ(told.pose().world_from_camera.translation,
            before.world_from_camera.translation);
}

// The error of such a sensor is one and the same for long: a thousand fixes in
// ten seconds are hardly better than one.
TEST(PoseFilter, FixesDoNotAverageOut) {
  PoseFilter filter = Moving(3);
  double least = 1.0;
  for (int i = 1; i <= 1'000; ++i) {
    const nanoseconds time = 3 * kStep + i * milliseconds(10);
    filter.Propagate(time);
    filter.UpdateFromPosition({PoseAt(time).translation, 0.2, {}});
    if (i > 500) least = std::min(least, filter.pose().covariance(0, 0));
  }
  EXPECT_GT(least, 0.1 * 0.1);
  EXPECT_LT(filter.pose().covariance(0, 0), 0.3 * 0.3);
}

TEST(PoseFilter, ManyStepsAreTheSameAsOne) {
  // Seen, coasting, and dying away.
  for (const int duration_ms : {200, 250, 1'200, 2'400}) {
    PoseFilter once = Moving(50);
    once.Remember(PoseFilter::kKeyFrame);
    PoseFilter often = once;
    once.Propagate(50 * kStep + milliseconds(duration_ms));
    constexpr int kParts = 40;
    for (int i = 1; i <= kParts; ++i) {
      often.Propagate(50 * kStep + milliseconds(duration_ms) * i / kParts);
    }
    const PoseEstimate a = once.pose();
    const PoseEstimate b = often.pose();
    EXPECT_LT((a.covariance - b.covariance).norm(), 1e-6 * a.covariance.norm())
        << duration_ms;
    EXPECT_LT(CenterError(a.world_from_camera, b.world_from_camera), 1e-6);
    EXPECT_LT((once.velocity_s() - often.velocity_s()).norm(), 1e-6);
  }
}

// A camera whose acceleration is what the model says, seen at three rates: what
// the filter says of a pose that it predicts, and of one that it has measured,
// is right at each.
TEST(PoseFilter, IsHonestAtEveryFrameRate) {
  constexpr int kRuns = 200;
  constexpr nanoseconds kTick = milliseconds(1);
  const PoseFilterOptions options;
  for (const int frames_per_second : {10, 25, 100}) {
    const int ticks = 1'000 / frames_per_second;
    std::mt19937_64 engine(7);
    std::normal_distribution<double> normal;
    const auto draw = [&](double sigma) {
      return Eigen::Vector3d(sigma * normal(engine),
                             sigma * normal(engine),
                             sigma * normal(engine));
    };
    double measured_sum = 0.0;
    double predicted_sum = 0.0;
    for (int run = 0; run < kRuns; ++run) {
      Eigen::Vector3d place = Eigen::Vector3d::Zero();
      Eigen::Vector3d velocity = draw(options.initial_velocity_s);
      const Rigid3 start = MakeWorldFromCamera();
      const auto truth = [&] {
        return Rigid3{start.rotation, start.translation + place};
      };
      const auto seen = [&] {
        Vector6d noise;
        noise << draw(1e-3), draw(1e-3);
        return MovePose(truth(), noise);
      };
      PoseFilter filter(options);
      filter.Start(nanoseconds(0), FromMap(seen()));
      const double tick_s = 1e-3;
      const double kick = options.acceleration_s2 *
                          std::sqrt(options.acceleration_lasts_s * tick_s);
      for (int tick = 1; tick <= 1'000; ++tick) {
        const Eigen::Vector3d before = velocity;
        velocity += draw(kick);
        place += 0.5 * tick_s * (before + velocity);
        if (tick % ticks != 0) continue;
        filter.Propagate(tick * kTick);
        const bool last = tick == 1'000;
        const auto nees = [&] {
          const Eigen::Vector3d error =
              truth().translation - filter.pose().world_from_camera.translation;
          return error.dot(
              Eigen::Matrix3d(filter.pose().covariance.topLeftCorner<3, 3>())
                  .ldlt()
                  .solve(error));
        };
        if (last) predicted_sum += nees();
        ASSERT_TRUE(filter.UpdateFromMap(FromMap(seen())));
        if (last) measured_sum += nees();
      }
    }
    EXPECT_NEAR(predicted_sum / kRuns, 3.0, 0.3 * 3.0) << frames_per_second;
    EXPECT_NEAR(measured_sum / kRuns, 3.0, 0.3 * 3.0) << frames_per_second;
  }
}

TEST(PoseFilter, RotationAloneTurnsThePose) {
  PoseFilter filter{PoseFilterOptions()};
  filter.Start(nanoseconds(0), FromMap(PoseAt(nanoseconds(0))));
  for (int i = 1; i <= 20; ++i) {
    filter.Remember(PoseFilter::kLastFrame);
    filter.Propagate(i * kStep);
    filter.UpdateRotation(PoseFilter::kLastFrame,
                          PoseAt((i - 1) * kStep).rotation.conjugate() *
                              PoseAt(i * kStep).rotation,
                          1e-4);
  }
  EXPECT_LT(AngleError_rad(filter.pose().world_from_camera, PoseAt(20 * kStep)),
            0.004);
  EXPECT_GT(filter.pose().covariance(0, 0), 0.1);
  EXPECT_LT(filter.pose().covariance(5, 5), 1e-5);
}

// Measurements that share half of their error: the filter does not believe that
// a hundred of them are a hundred times as good as one.
TEST(PoseFilter, SharedErrorsDoNotAverageOut) {
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal;
  const auto draw = [&](double sigma) {
    Vector6d v;
    for (int i = 0; i < 6; ++i) v[i] = sigma * normal(engine);
    return v;
  };
  constexpr int kRuns = 60;
  constexpr int kFrames = 60;
  constexpr double kShared = 0.9;
  double sum = 0.0;
  double blind_sum = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    PoseFilterOptions options;
    options.acceleration_s2 = 0.05;
    options.angular_acceleration_rad_s2 = 0.05;
    options.initial_velocity_s = 0.01;
    options.initial_angular_velocity_rad_s = 0.01;
    PoseFilter filter(options);
    PoseFilter blind(options);
    Vector6d bias = draw(3e-3);
    for (int i = 0; i <= kFrames; ++i) {
      bias = kShared * bias + std::sqrt(1.0 - kShared * kShared) * draw(3e-3);
      const Rigid3 measured =
          MovePose(MakeWorldFromCamera(), bias + draw(1e-3));
      const auto honest =
          FromMap(measured, Sharp(), 9e-6 * Matrix6d::Identity(), kShared);
      const auto naive = FromMap(measured, 1e-5 * Matrix6d::Identity());
      if (i == 0) {
        filter.Start(nanoseconds(0), honest);
        blind.Start(nanoseconds(0), naive);
      } else {
        filter.Propagate(i * kStep);
        blind.Propagate(i * kStep);
        filter.UpdateFromMap(honest);
        blind.UpdateFromMap(naive);
      }
    }
    sum += Nees(filter.pose(), MakeWorldFromCamera());
    blind_sum += Nees(blind.pose(), MakeWorldFromCamera());
  }
  // The camera rests, which the model leaves room for: below 6 is honest.
  EXPECT_LT(sum / kRuns, 8.0);
  EXPECT_GT(sum / kRuns, 2.0);
  EXPECT_GT(blind_sum / kRuns, 1.5 * sum / kRuns);
}

TEST(PoseFilter, CovarianceStaysSymmetricAndPositive) {
  PoseFilter filter = Moving(3);
  for (int i = 4; i < 2'000; ++i) {
    if (i % 10 == 4) filter.Remember(PoseFilter::kKeyFrame);
    filter.Remember(PoseFilter::kLastFrame);
    filter.Propagate(i * kStep);
    if (i % 7 == 0) {
      filter.UpdateFromMap(FromMap(PoseAt(i * kStep), Sharp(), Sharp(), 0.5));
    } else {
      filter.UpdateRelative(
          PoseFilter::kKeyFrame,
          filter.pose(PoseFilter::kKeyFrame).world_from_camera,
          {filter.pose().world_from_camera, Sharp()},
          kOrdinary);
    }
    const PoseEstimate estimate = filter.pose();
    ASSERT_LT((estimate.covariance - estimate.covariance.transpose()).norm(),
              1e-12);
    ASSERT_GT(estimate.covariance.diagonal().minCoeff(), 0.0);
    ASSERT_TRUE(estimate.world_from_camera.IsFinite());
  }
}

}  // namespace
}  // namespace groundlock::localization
