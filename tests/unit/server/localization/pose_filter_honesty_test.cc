// SPDX-License-Identifier: Apache-2.0
// Whether the filter errs as much as it says, also where something is farther
// off than was expected.
#include <cmath>
#include <random>

#include "tests/unit/server/localization/pose_filter_test.h"

namespace groundlock::localization {
namespace {

// A pose found in the map that says it is as sure as what is known counts half;
// one that is farther off than both say counts less.
TEST(PoseFilter, APoseOfTheMapMayErrMoreThanItSays) {
  PoseFilter filter = Moving(50);
  const PoseEstimate before = filter.pose();
  const double sigma = std::sqrt(before.covariance(0, 0));
  const auto off_by = [&](double distance) {
    PoseFilter told = filter;
    Rigid3 seen = before.world_from_camera;
    seen.translation.x() += distance;
    EXPECT_TRUE(told.UpdateFromMap(FromMap(seen, before.covariance)));
    return (told.pose().world_from_camera.translation.x() -
            before.world_from_camera.translation.x()) /
           distance;
  };
  EXPECT_NEAR(off_by(sigma), 0.5, 0.01);
  EXPECT_LT(off_by(7.0 * sigma), 0.3);
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
      return Eigen::Vector3d{sigma * normal(engine),
                             sigma * normal(engine),
                             sigma * normal(engine)};
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

}  // namespace
}  // namespace groundlock::localization
