// SPDX-License-Identifier: Apache-2.0
// How far away a target is, and how well that is known, where the ground is
// seen at a grazing angle.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <optional>
#include <random>

#include "absl/status/statusor.h"
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

absl::StatusOr<GroundTarget> Drawn(const CameraView& camera,
                                   const geometry::Box3& body) {
  const auto seen = ground::ProjectBodyHull(camera.view, body);
  if (!seen) return absl::InvalidArgumentError("it does not project");
  return GroundTarget::Create(camera,
                              *seen,
                              milliseconds(0),
                              BoxCenter::kTexture,
                              motion::MotionOptions());
}

// What is taken to be higher than it is seems nearer than it is: a tenth of the
// camera's height is a tenth of the range, however small a pixel is.
TEST(GroundTargetRange, IsKnownAsWellAsTheHeightOfWhatIsFollowed) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> heading(0.0, 3.14);
  std::uniform_real_distribution<double> log_height(-0.25, 0.25);
  for (const double eye_m : {0.8, 1.2, 2.0, 4.0, 8.0}) {
    double squared = 0.0;
    double sigma_m = 0.0;
    constexpr int kTimes = 60;
    for (int i = 0; i < kTimes; ++i) {
      const double heading_rad = heading(random);
      const double height_m = 0.35 * std::exp(log_height(random));
      const geometry::Box3 body =
          StandingAt(Vector3d::Zero(), heading_rad, {0.9, 0.5, height_m});
      const CameraView camera = ViewFrom({0.0, -6.0, eye_m}, {0.0, 0.0, 0.2});
      const auto target = Drawn(camera, body);
      ASSERT_TRUE(target.ok()) << target.status();
      const double off_m = target->box().BottomCenterWorld().y();
      sigma_m = target->RangeSigma_m(camera);
      squared += std::pow(off_m / sigma_m, 2);
    }
    // A normal distribution has 1 in the mean.
    EXPECT_LT(squared / kTimes, 2.0) << eye_m << " m: sigma " << sigma_m;
  }
}

// Seen from higher and higher, a car at rest seems to come along the view, if
// its height was taken wrongly: that is no way that it went.
TEST(GroundTargetRange, ACameraThatRisesTellsNoWayOfWhatRests) {
  for (const double height_m : {0.25, 0.35, 0.5}) {
    const geometry::Box3 body =
        StandingAt(Vector3d::Zero(), 0.3, {0.9, 0.5, height_m});
    std::optional<GroundTarget> target;
    for (int frame = 0; frame <= 100; ++frame) {
      const CameraView camera =
          ViewFrom({0.0, -6.0, 0.6 + 0.02 * frame}, {0.0, 0.0, 0.2});
      if (!target) {
        auto drawn = Drawn(camera, body);
        ASSERT_TRUE(drawn.ok()) << drawn.status();
        target.emplace(*std::move(drawn));
        continue;
      }
      target->Predict(milliseconds(40 * frame));
      const auto seen = ground::ProjectBodyHull(camera.view, body);
      ASSERT_TRUE(seen);
      const auto sighting = target->Lift(camera, *seen);
      ASSERT_TRUE(sighting) << frame;
      target->Update(camera, *sighting);
      ASSERT_FALSE(target->front_known()) << height_m << " m, " << frame;
    }
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
    if (!target) {
      auto drawn = Drawn(camera, body);
      ASSERT_TRUE(drawn.ok()) << drawn.status();
      target.emplace(*std::move(drawn));
      continue;
    }
    target->Predict(milliseconds(40 * frame));
    const auto seen = ground::ProjectBodyHull(camera.view, body);
    ASSERT_TRUE(seen);
    const auto sighting = target->Lift(camera, *seen);
    ASSERT_TRUE(sighting) << frame;
    target->Update(camera, *sighting);
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
