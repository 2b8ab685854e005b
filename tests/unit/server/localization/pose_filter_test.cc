// SPDX-License-Identifier: Apache-2.0
#include "tests/unit/server/localization/pose_filter_test.h"

#include <cmath>

namespace groundlock::localization {
namespace {

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

TEST(PoseFilter, WhatConfirmsLiesWhereItIsKnownToBe) {
  PoseFilter filter = Moving(20);
  filter.Remember(PoseFilter::kAnchorFrame);
  const auto aside = [&](double sigmas) {
    Rigid3 pose = filter.pose(PoseFilter::kAnchorFrame).world_from_camera;
    pose.translation.x() += sigmas * 1e-3;
    return FromMap(pose);
  };
  EXPECT_TRUE(filter.Confirms(PoseFilter::kAnchorFrame, aside(0.0)));
  EXPECT_TRUE(filter.Confirms(PoseFilter::kAnchorFrame, aside(3.0)));
  // A heavy tail may explain that, and is taken in; it confirms nothing.
  EXPECT_FALSE(filter.Confirms(PoseFilter::kAnchorFrame, aside(12.0)));
  EXPECT_TRUE(filter.UpdateFromMap(PoseFilter::kAnchorFrame, aside(12.0)));
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
