// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/patch_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>
#include <optional>

#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "tests/unit/server/tracking/painted_box.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;
using geometry::Box3;

class PatchMemoryTest : public PaintedBoxTest {
 protected:
  // The body was seen at the origin from the front.
  void Keep() {
    const CameraView camera = CameraFrom(0.0);
    const Box3 body = BodyAt(0.0);
    memory_.Keep(
        FrameOf(camera, &body), camera, body, Outline(camera, body), 0.0);
  }

  // The largest error in the image of a patch of a body in `camera`, in px.
  static double WorstError_px(const PatchMemory::Match& match,
                              const CameraView& camera,
                              const Box3& body) {
    double worst_px = 0.0;
    for (const PatchMemory::Patch& patch : match.patches) {
      const Vector3d p_world =
          body.world_from_object *
          (patch.p_body - Vector3d(0.0, 0.0, 0.5 * body.size_m.z()));
      worst_px =
          std::max(worst_px,
                   (*camera.view.camera->ImageFromCamera(
                        camera.view.world_from_camera.Inverse() * p_world) -
                    patch.now_px)
                       .norm());
    }
    return worst_px;
  }

  PatchMemory memory_;
};

TEST_F(PatchMemoryTest, KnowsABodyAgainFromAnotherSideAndDistance) {
  Keep();
  const Box3 body = BodyAt(0.0);
  for (const double azimuth_deg : {0.0, -20.0, 30.0}) {
    const CameraView camera = CameraFrom(azimuth_deg, 3.2);
    const image::Frame frame = FrameOf(camera, &body);
    for (const bool rests : {true, false}) {
      const auto match = memory_.Find(frame, camera, body, rests);
      ASSERT_TRUE(match) << azimuth_deg;
      EXPECT_GE(match->patches.size(), 12) << azimuth_deg;
      EXPECT_LT(WorstError_px(*match, camera, body), 4.0) << azimuth_deg;
      EXPECT_LT(match->shift_px.norm(), 1.0) << azimuth_deg;
    }
  }
}

TEST_F(PatchMemoryTest, TellsHowFarBesideItsPlaceABodyIs) {
  Keep();
  const CameraView camera = CameraFrom(10.0);
  const Box3 body = BodyAt(0.5);
  const Box3 asked = BodyAt(0.44);
  const auto match = memory_.Find(FrameOf(camera, &body), camera, asked, false);
  ASSERT_TRUE(match);
  const Vector2d beside_px =
      Outline(camera, body).center_px() - Outline(camera, asked).center_px();
  ASSERT_GT(beside_px.norm(), 6.0);
  EXPECT_LT((match->shift_px - beside_px).norm(), 1.0);
  EXPECT_LT(WorstError_px(*match, camera, body), 4.0);
}

TEST_F(PatchMemoryTest, KnowsABodyThatIsHalfHidden) {
  Keep();
  const CameraView camera = CameraFrom(10.0);
  const Box3 body = BodyAt(0.0);
  const image::Frame whole = FrameOf(camera, &body);
  cv::Mat bgr = whole.Bgr().clone();
  const Box2 outline_px = Outline(camera, body);
  bgr(cv::Rect(0, 0, static_cast<int>(outline_px.center_px().x()), bgr.rows)) =
      cv::Scalar::all(60);
  const auto match =
      memory_.Find(image::Frame::FromBgr(bgr), camera, body, true);
  ASSERT_TRUE(match);
  for (const PatchMemory::Patch& patch : match->patches) {
    EXPECT_GT(patch.now_px.x(), outline_px.center_px().x() - 3.0);
  }
}

TEST_F(PatchMemoryTest, AnotherBodyBareGroundAndAnotherPlaceAreNotIt) {
  Keep();
  const CameraView camera = CameraFrom(10.0);
  const Box3 body = BodyAt(0.0);
  const image::Frame bare = FrameOf(camera, nullptr);
  const image::Frame itself = FrameOf(camera, &body);
  const Box3 elsewhere = BodyAt(1.1);
  for (const bool rests : {true, false}) {
    for (const std::uint32_t paint : {20U, 300U, 4'000U, 50'000U}) {
      EXPECT_FALSE(
          memory_.Find(FrameOf(camera, &body, paint), camera, body, rests));
    }
    EXPECT_FALSE(memory_.Find(bare, camera, body, rests));
    EXPECT_FALSE(memory_.Find(itself, camera, elsewhere, rests));
  }
}

// What was kept in another frame of the body would be looked for on other
// faces.
TEST_F(PatchMemoryTest, ForgetsWhatWasKeptInAnotherFrame) {
  constexpr double kTurned_rad = 0.5;
  Keep();
  EXPECT_TRUE(memory_.AreKnownIn(0.1));
  EXPECT_TRUE(memory_.AreKnownIn(2.0 * std::numbers::pi - 0.1));
  EXPECT_FALSE(memory_.AreKnownIn(kTurned_rad));
  // Seen again, it has nothing on it.
  const CameraView camera = CameraFrom(0.0);
  const Box3 body = BodyAt(0.0);
  const image::Frame bare = FrameOf(camera, nullptr);
  memory_.Keep(bare, camera, body, Outline(camera, body), kTurned_rad);
  EXPECT_TRUE(memory_.AreKnownIn(kTurned_rad));
  EXPECT_FALSE(memory_.Find(FrameOf(camera, &body), camera, body, true));
}

// Seen from elsewhere, one that has gone nearer is not where two views of a
// body at rest have it.
TEST_F(PatchMemoryTest, OneThatHasMovedDoesNotRest) {
  Keep();
  const CameraView camera = CameraFrom(25.0);
  const Box3 body = BodyAt(0.0, -0.15);
  const image::Frame frame = FrameOf(camera, &body);
  EXPECT_TRUE(memory_.Find(frame, camera, BodyAt(0.0), false));
  EXPECT_FALSE(memory_.Find(frame, camera, BodyAt(0.0), true));
}

TEST_F(PatchMemoryTest, TellsNothingWithoutAPictureOrFromBehindOrOutOfView) {
  const Box3 body = BodyAt(0.0);
  const CameraView front = CameraFrom(0.0);
  EXPECT_FALSE(memory_.Find(FrameOf(front, &body), front, body, true));
  Keep();
  const CameraView back = CameraFrom(180.0);
  EXPECT_FALSE(memory_.Find(FrameOf(back, &body), back, body, true));
  for (const double x_m : {-4.0, 4.0, 60.0}) {
    EXPECT_FALSE(
        memory_.Find(FrameOf(front, nullptr), front, BodyAt(x_m), false));
  }
  EXPECT_FALSE(
      memory_.Find(FrameOf(front, nullptr), front, BodyAt(0.0, -8.0), false));
}

}  // namespace
}  // namespace groundlock::tracking
