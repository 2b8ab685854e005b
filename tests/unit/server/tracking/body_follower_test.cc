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

using BodyFollowerTest = PaintedBoxTest;

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
    const auto standing = [](const Box3& box) -> geometry::Rigid3 {
      return {box.world_from_object.rotation, box.BottomCenterWorld()};
    };
    if (frame > 0) {
      follower.Follow(
          picture, camera, outline_px, {standing(body), standing(before)});
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
