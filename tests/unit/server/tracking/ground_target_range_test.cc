// SPDX-License-Identifier: Apache-2.0
// How far away a target is, and how well that is known, where the ground is
// seen at a grazing angle.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <optional>
#include <random>
#include <utility>

#include "server/tracking/ground_target.h"
#include "tests/unit/server/tracking/views_of_ground.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using std::chrono::milliseconds;

geometry::Box3 StandingAt(const Vector3d& place,
                          double heading_rad,
                          const Vector3d& size_m) {
  return ground::UprightBox(
      {}, place, {std::cos(heading_rad), std::sin(heading_rad), 0.0}, size_m);
}

// It is seen in one frame more; drawn in the first one. False: it is not
// placed.
bool FollowIn(const CameraView& camera,
              const geometry::Box3& body,
              std::chrono::nanoseconds time,
              std::optional<GroundTarget>& target) {
  const auto seen = ground::ProjectBodyHull(camera.view, body);
  if (!seen) return false;
  if (!target) {
    auto drawn = GroundTarget::Create(
        camera, *seen, time, BoxCenter::kTexture, motion::MotionOptions());
    if (drawn.ok()) target.emplace(*std::move(drawn));
    return drawn.ok();
  }
  target->Predict(time);
  const auto sighting = target->Lift(camera, *seen);
  if (sighting) target->Update(camera, *sighting);
  return sighting.has_value();
}

// It is drawn from so low, and followed while the camera rises so far.
std::optional<GroundTarget> Followed(const geometry::Box3& body,
                                     double from_m,
                                     double to_m) {
  std::optional<GroundTarget> target;
  constexpr int kFrames = 50;
  for (int frame = 0; frame <= kFrames; ++frame) {
    const double eye_m = from_m + (to_m - from_m) * frame / kFrames;
    const CameraView camera = ViewFrom({0.0, -6.0, eye_m}, {0.0, 0.0, 0.2});
    if (!FollowIn(camera, body, milliseconds(40 * frame), target)) {
      return std::nullopt;
    }
  }
  return target;
}

// What is taken to be higher than it is seems to come nearer as the camera
// rises, by centimetres where a pixel is millimetres.
TEST(GroundTargetRange, IsKnownAsWellAsTheHeightOfWhatIsFollowed) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> heading(0.0, 3.14);
  std::uniform_real_distribution<double> log_height(-0.25, 0.25);
  for (const auto& [from_m, to_m] :
       {std::pair(0.6, 1.2), {0.6, 2.4}, {1.0, 4.0}, {3.0, 1.0}, {3.0, 3.0}}) {
    double squared = 0.0;
    constexpr int kTimes = 60;
    for (int i = 0; i < kTimes; ++i) {
      const double heading_rad = heading(random);
      const double height_m = 0.35 * std::exp(log_height(random));
      const auto target = Followed(
          StandingAt(Vector3d::Zero(), heading_rad, {0.9, 0.5, height_m}),
          from_m,
          to_m);
      ASSERT_TRUE(target);
      const CameraView camera = ViewFrom({0.0, -6.0, to_m}, {0.0, 0.0, 0.2});
      squared += std::pow(
          target->box().BottomCenterWorld().y() / target->RangeSigma_m(camera),
          2);
    }
    // A normal distribution has 1 in the mean; what else a body's shape is off
    // by has 3.0 (from above), and the height that was taken for known had 36
    // where the camera sinks.
    EXPECT_LT(squared / kTimes, 4.0) << from_m << " m to " << to_m;
  }
}

// A way across such a view is told at once, and so is where it heads.
TEST(GroundTargetRange, AWayAcrossTheViewTellsTheHeading) {
  std::optional<GroundTarget> target;
  int known_at = 0;
  for (int frame = 0; frame < 60 && known_at == 0; ++frame) {
    const geometry::Box3 body =
        StandingAt({-1.0 + 0.04 * frame, 0.0, 0.0}, 0.0, {0.9, 0.5, 0.35});
    const CameraView camera = ViewFrom({0.0, -6.0, 0.8}, {0.0, 0.0, 0.2});
    ASSERT_TRUE(FollowIn(camera, body, milliseconds(40 * frame), target));
    if (target->front_known()) known_at = frame;
  }
  ASSERT_GT(known_at, 0);
  EXPECT_LT(known_at, 30);
  const Vector3d heading =
      target->box().world_from_object.rotation * Vector3d::UnitX();
  EXPECT_LT(std::abs(std::atan2(heading.y(), heading.x())), 0.2);
}

}  // namespace
}  // namespace groundlock::tracking
