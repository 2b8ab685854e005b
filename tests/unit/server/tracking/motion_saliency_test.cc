// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/motion_saliency.h"

#include <gtest/gtest.h>

#include <limits>
#include <opencv2/imgproc.hpp>

#include "tests/support/perturbation.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;

constexpr double kSide_px = 24.0;
constexpr int kCameraStep_px = 3;

// A landscape under a camera that goes three pixels to the right a frame, ten
// frames a second, and a body of its colours.
class MotionSaliencyTest : public ::testing::Test {
 protected:
  MotionSaliencyTest() {
    cv::RNG rng(7);
    world_ = Noise(rng, {700, 300});
    body_ = Noise(rng, {24, 24});
  }

  static cv::Mat Noise(cv::RNG& rng, const cv::Size& size) {
    cv::Mat noise(size, CV_8UC3);
    rng.fill(noise, cv::RNG::UNIFORM, cv::Scalar::all(0), cv::Scalar::all(255));
    cv::GaussianBlur(noise, noise, {}, 2.0);
    cv::normalize(noise, noise, 60, 180, cv::NORM_MINMAX);
    return noise;
  }
  // Where the body is that stands at `world_px`.
  Box2 BoxAt(double world_px) const {
    return Box2::FromXywh(
        world_px - kCameraStep_px * frame_, 120.0, kSide_px, kSide_px);
  }
  image::Frame Frame(int world_px) const {
    cv::Mat world = world_.clone();
    body_.copyTo(world(cv::Rect(world_px, 120, body_.cols, body_.rows)));
    const cv::Rect seen(kCameraStep_px * frame_, 0, 400, 300);
    image::Frame frame =
        image::Frame::FromBgr(test_support::Perturbed(world(seen).clone()));
    frame.capture_time = milliseconds(100 * frame_);
    return frame;
  }
  // The next frame, with the body at `world_px`; whoever follows it has its box
  // at `box_world_px`.
  void Next(int world_px, double box_world_px, bool camera_is_known = false) {
    ++frame_;
    ImageAffinity camera;
    camera.shift_px.x() = -kCameraStep_px;
    saliency_.Add(Frame(world_px),
                  camera,
                  camera_is_known,
                  BoxAt(box_world_px),
                  BoxAt(box_world_px));
  }
  double OffSpot_px(double world_px) const {
    const auto spot = saliency_.spot();
    if (!spot) return std::numeric_limits<double>::infinity();
    return (spot->box_px.center_px() - BoxAt(world_px).center_px()).norm();
  }

  cv::Mat world_;
  cv::Mat body_;
  MotionSaliency saliency_;
  int frame_ = 0;
};

TEST_F(MotionSaliencyTest, WhatWasMarkedIsFollowedThoughItsBoxStays) {
  saliency_.Restart(Frame(150), BoxAt(150));
  for (int i = 1; i <= 25; ++i) {
    // The box has stayed with the background from the first frame on.
    Next(150 + 2 * i, 150.0);
    if (i < 8) continue;
    EXPECT_LT(OffSpot_px(150.0 + 2 * i), 0.4 * kSide_px) << i;
  }
  EXPECT_NEAR(saliency_.spot()->velocity_px_s.x(), 20.0, 6.0);
  EXPECT_LT(saliency_.ShareAt(BoxAt(150.0)).value_or(1.0),
            0.2 * saliency_.spot()->share);
}

TEST_F(MotionSaliencyTest, WhatBeginsToMoveAndStopsAgain) {
  saliency_.Restart(Frame(150), BoxAt(150));
  int world_px = 150;
  const auto go = [&](int frames, int step_px) {
    for (int i = 0; i < frames; ++i) {
      world_px += step_px;
      Next(world_px, world_px);
      saliency_.Learn(BoxAt(world_px));
    }
  };
  go(15, 0);
  EXPECT_FALSE(saliency_.spot());
  EXPECT_LT(saliency_.ShareAt(BoxAt(world_px)).value_or(1.0), 0.02);
  go(12, 3);
  EXPECT_LT(OffSpot_px(world_px), 0.3 * kSide_px);
  go(15, 0);
  EXPECT_FALSE(saliency_.spot());
}

TEST_F(MotionSaliencyTest, WhatStandsHasNoSpotThoughAnotherPasses) {
  // A piece of the landscape, which another passes close by.
  const auto standing = [&] {
    return Box2::FromXywh(
        200.0 - kCameraStep_px * frame_, 150.0, kSide_px, kSide_px);
  };
  saliency_.Restart(Frame(100), standing());
  for (int i = 1; i <= 40; ++i) {
    ++frame_;
    ImageAffinity camera;
    camera.shift_px.x() = -kCameraStep_px;
    saliency_.Add(Frame(100 + 5 * i), camera, false, standing(), standing());
    saliency_.Learn(standing());
    EXPECT_FALSE(saliency_.spot()) << i;
  }
}

// It needs five seconds to leave its place: what it uncovers differs from
// pictures of the last second as it does itself.
TEST_F(MotionSaliencyTest, ASlowTargetIsToldByAPictureFromBeforeItCame) {
  saliency_.Restart(Frame(350), BoxAt(350));
  int wrong = 0;
  for (int i = 1; i <= 90; ++i) {
    const int world_px = 350 + i / 2;
    Next(world_px, world_px, /*camera_is_known=*/true);
    saliency_.Mark(BoxAt(world_px));
    saliency_.Learn(BoxAt(world_px));
    if (i < 65) continue;
    ASSERT_TRUE(saliency_.spot()) << i;
    EXPECT_TRUE(saliency_.spot()->is_whole) << i;
    EXPECT_LT(OffSpot_px(world_px), 0.15 * kSide_px) << i;
    // What lies behind it, where it was a while ago, does not move.
    wrong += saliency_.ShareAt(BoxAt(world_px - kSide_px)).value_or(1.0) > 0.2;
  }
  EXPECT_EQ(wrong, 0);
}

// Until there is a picture from before it came, its empty place leaves a trace,
// which does not go on.
TEST_F(MotionSaliencyTest, WhatVanishesLeavesNothingThatGoesOn) {
  saliency_.Restart(Frame(100), BoxAt(100));
  int world_px = 100;
  for (int i = 1; i <= 6; ++i) {
    world_px += 2;
    Next(world_px, world_px, /*camera_is_known=*/true);
    saliency_.Mark(BoxAt(world_px));
    saliency_.Learn(BoxAt(world_px));
  }
  ASSERT_TRUE(saliency_.spot());
  EXPECT_TRUE(saliency_.spot()->has_gone_on);
  for (int i = 1; i <= 15; ++i) {
    // It is out of the picture from one frame to the next.
    Next(600, world_px + 2 * i, /*camera_is_known=*/true);
    const auto spot = saliency_.spot();
    if (i == 1) {
      EXPECT_TRUE(spot);
    }
    EXPECT_FALSE(spot && spot->has_gone_on) << i;
  }
}

TEST_F(MotionSaliencyTest, WithoutTheBackgroundsMotionNothingIsKnown) {
  saliency_.Restart(Frame(150), BoxAt(150));
  for (int i = 1; i <= 20; ++i) Next(150 + 2 * i, 150.0);
  ASSERT_TRUE(saliency_.spot());
  ++frame_;
  saliency_.Add(Frame(192), std::nullopt, false, BoxAt(192), BoxAt(192));
  EXPECT_FALSE(saliency_.spot());
  EXPECT_FALSE(saliency_.ShareAt(BoxAt(192)));
  // Boxes that are nowhere, or everywhere, and two frames of one time.
  for (const Box2& box : {Box2::FromXywh(-900, -900, 10, 10),
                          Box2::FromXywh(-1e6, -1e6, 2e6, 2e6),
                          Box2::FromXywh(100, 100, 1e-3, 1e-3)}) {
    for (int i = 0; i < 12; ++i) {
      if (i != 5) ++frame_;
      saliency_.Add(Frame(192), ImageAffinity(), i % 2 == 0, box, box);
      saliency_.Learn(box);
    }
    EXPECT_FALSE(saliency_.spot());
  }
}

}  // namespace
}  // namespace groundlock::tracking
