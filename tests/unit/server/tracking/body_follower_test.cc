// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/body_follower.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <optional>

#include "server/ground/box_fit.h"
#include "tests/unit/server/tracking/painted_box.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;
using geometry::Box3;

class BodyFollowerTest : public PaintedBoxTest {
 protected:
  static geometry::Rigid3 Standing(const Box3& box) {
    return {box.world_from_object.rotation, box.BottomCenterWorld()};
  }
  // The frame in which the body stands there; it is seen whole.
  void See(const Box3& body) {
    follower_.Observe(
        FrameOf(camera_view_, &body),
        camera_view_,
        Outline(camera_view_, body),
        std::nullopt,
        {.box_world = body, .moves = true, .heading_known = true});
  }
  void Follow(const Box3& body, const ExpectedMotion& motion) {
    follower_.Follow(FrameOf(camera_view_, &body),
                     camera_view_,
                     Outline(camera_view_, body),
                     motion);
  }
  // It goes by; then at most so many of its points are known.
  void GoBy(std::size_t most_known) {
    for (int frame = 0; frame < 30; ++frame) {
      const Box3 body = BodyAt(kStart_m + kStep_m * frame);
      if (frame > 0) {
        Follow(body,
               {Standing(body),
                Standing(BodyAt(kStart_m + kStep_m * (frame - 1)))});
      }
      See(body);
    }
    const BodyFollower::Tracks seen = follower_.TracksOfMotion();
    BodyFollower::Found found;
    for (const ground::BodyView& view : seen.views) {
      found.world_from_body.push_back(view.world_from_body);
    }
    for (std::size_t i = 0; i < seen.tracks.size(); ++i) {
      const auto& last = seen.tracks[i].observations.back();
      if (last.view + 1 < seen.views.size() ||
          found.tracks.size() == most_known) {
        continue;
      }
      const Box3 body = BodyAt(0.0);
      const Vector3d p_box =
          ground::PointOnRay({&camera_,
                              seen.views[last.view].world_from_body.Inverse() *
                                  camera_view_.view.world_from_camera,
                              {}},
                             body,
                             last.pixel_px,
                             /*depth=*/1.0);
      if (p_box.isZero()) continue;
      found.tracks.push_back(i);
      found.points_body.push_back(p_box +
                                  0.5 * body.size_m.z() * Vector3d::UnitZ());
    }
    follower_.Refine(seen, found);
  }
  Box3 Last() const { return BodyAt(kStart_m + kStep_m * 29); }

  static constexpr double kStart_m = -0.5;
  static constexpr double kStep_m = 0.03;
  CameraView camera_view_ = CameraFrom(0.0);
  BodyFollower follower_;
};

// What tells that the body's middle is elsewhere among its points tells it of
// each view in which these were placed.
TEST_F(BodyFollowerTest, AnotherMiddleIsThatOfEachView) {
  GoBy(/*most_known=*/1000);
  const Vector3d by_m(0.1, -0.05, 0.0);
  const BodyFollower::Tracks before = follower_.TracksOfMotion();
  follower_.ShiftPoints(by_m);
  const BodyFollower::Tracks after = follower_.TracksOfMotion();
  ASSERT_EQ(before.views.size(), after.views.size());
  std::size_t known = 0;
  for (std::size_t i = 0; i < before.tracks.size(); ++i) {
    if (!before.known_body[i]) continue;
    ++known;
    EXPECT_NEAR((*after.known_body[i] - *before.known_body[i] - by_m).norm(),
                0.0,
                1e-12);
    const std::size_t view = before.tracks[i].observations.back().view;
    const Vector3d was_world =
        before.views[view].world_from_body * *before.known_body[i];
    const Vector3d is_world =
        after.views[view].world_from_body * *after.known_body[i];
    EXPECT_NEAR((is_world - was_world).norm(), 0.0, 1e-9);
  }
  EXPECT_GT(known, 40U);
}

// While a body turns its velocity is known badly: 120 degrees off, its points
// still go, and only another way.
TEST_F(BodyFollowerTest, WhatGoesAnotherWayHasNotStayedBehind) {
  GoBy(/*most_known=*/1000);
  const std::size_t known = follower_.SightingsInMotion().size();
  ASSERT_GT(known, 40U);
  const Box3 next = BodyAt(kStart_m + kStep_m * 30 + 0.05);
  geometry::Rigid3 before = Standing(next);
  before.translation -= 0.08 * Vector3d(-0.5, -0.866, 0.0);
  Follow(next, {Standing(next), before});
  EXPECT_GT(follower_.SightingsInMotion().size(), known * 8 / 10);
  EXPECT_FALSE(follower_.last_hidden());
}

TEST_F(BodyFollowerTest, WhatRestsStaysBehind) {
  GoBy(/*most_known=*/1000);
  ASSERT_GT(follower_.SightingsInMotion().size(), 40U);
  geometry::Rigid3 gone = Standing(Last());
  gone.translation += 0.08 * Vector3d::UnitX();
  Follow(Last(), {gone, Standing(Last())});
  EXPECT_TRUE(follower_.SightingsInMotion().empty());
  EXPECT_TRUE(follower_.last_hidden());
}

// A body that has gone 40 px farther than expected: something is found for
// nearly each of its points, and from there not the way back.
TEST_F(BodyFollowerTest, WhatDoesNotComeBackIsLost) {
  GoBy(/*most_known=*/1000);
  const std::size_t known = follower_.SightingsInMotion().size();
  ASSERT_GT(known, 40U);
  const Box3 jumped = BodyAt(kStart_m + kStep_m * 29 + 0.3);
  follower_.Follow(FrameOf(camera_view_, &jumped),
                   camera_view_,
                   Outline(camera_view_, Last()),
                   {Standing(Last()), Standing(Last())});
  EXPECT_LT(follower_.SightingsInMotion().size(), known / 5);
}

// Each view counts while few points are known, for what turns loses these
// quickly.
TEST_F(BodyFollowerTest, EachViewIsNewsWhileFewPointsAreKnown) {
  for (const std::size_t most_known : {1000U, 8U}) {
    follower_ = BodyFollower();
    GoBy(most_known);
    EXPECT_TRUE(follower_.HasNews());
    EXPECT_EQ(follower_.HasNews(), most_known == 8U);
  }
}

// A box goes by behind a post, which takes points of it along: with them it
// would lag behind by as much. Of 90 tracks 84 were carried away as long as
// nothing looked at them.
TEST_F(BodyFollowerTest, EndsWhatAPostCarriedAway) {
  const CameraView camera = CameraFrom(0.0);
  BodyFollower follower;
  for (int frame = 0; frame < 40; ++frame) {
    const Box3 body = BodyAt(-0.6 + 0.03 * frame);
    const Box3 before = BodyAt(-0.6 + 0.03 * (frame - 1));
    const image::Frame picture =
        FrameOf(camera, &body, 1, std::array<int, 2>{314, 326});
    const Box2 outline_px = Outline(camera, body);
    if (frame > 0) {
      follower.Follow(
          picture, camera, outline_px, {Standing(body), Standing(before)});
    }
    follower.Observe(picture,
                     camera,
                     outline_px,
                     std::nullopt,
                     {.box_world = body, .moves = true, .heading_known = true});
  }
  const BodyFollower::Tracks seen = follower.TracksOfMotion();
  int followed = 0;
  int carried = 0;
  for (const ground::BodyTrack& track : seen.tracks) {
    const auto place = [&](const ground::BodyTrack::Observation& observation) {
      const ground::BodyView& view = seen.views[observation.view];
      Box3 body = BodyAt(0.0);
      body.world_from_object.translation =
          view.world_from_body * Vector3d(0.0, 0.0, 0.5 * body.size_m.z());
      return ground::PointOnRay(
          camera.view, body, observation.pixel_px, /*depth=*/1.0);
    };
    if (track.observations.size() < 4) continue;
    ++followed;
    const Vector3d first = place(track.observations.front());
    const Vector3d last = place(track.observations.back());
    if (std::abs(last.x() - first.x()) > 0.04) ++carried;
  }
  EXPECT_GE(followed, 50);
  EXPECT_LE(carried, followed / 6);
}

}  // namespace
}  // namespace groundlock::tracking
