// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/ground_target.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "tests/unit/server/tracking/views_of_ground.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;

constexpr double kFramesPerSecond = 10.0;
// So slowly that half of its length takes longer than the heading needs to
// follow.
constexpr double kSpeed_m_s = 2.5;
const Vector3d kCar_m(4.5, 1.8, 1.5);

// A car drives straight along y; a camera goes along with it, `offset_m` from
// it. Returns the largest error of the heading's axis after the first seconds.
double LargestHeadingError_rad(const Vector3d& offset_m) {
  std::mt19937 random(7);
  std::normal_distribution<double> noise_px(0.0, 0.5);
  std::optional<GroundTarget> target;
  double largest_rad = 0.0;
  for (int frame = 0; frame < 150; ++frame) {
    const double t_s = frame / kFramesPerSecond;
    const std::chrono::nanoseconds time(
        static_cast<std::int64_t>(std::llround(1e9 * t_s)));
    const Vector3d car(0.0, kSpeed_m_s * t_s, 0.0);
    const CameraView camera = ViewFrom(car + offset_m, car);
    const auto hull = ground::ProjectBodyHull(
        camera.view,
        ground::UprightBox(geometry::Plane(), car, Vector3d::UnitY(), kCar_m));
    if (!hull) ADD_FAILURE() << "out of view";
    const Box2 seen = Box2::FromCenter(
        hull->center_px() + Eigen::Vector2d{noise_px(random), noise_px(random)},
        hull->size_px());
    if (!target) {
      auto created = GroundTarget::Create(
          camera, seen, time, BoxCenter::kTexture, motion::MotionOptions());
      EXPECT_TRUE(created.ok()) << created.status();
      target.emplace(*std::move(created));
      continue;
    }
    target->Predict(time);
    if (const auto sighting = target->Lift(camera, seen)) {
      target->Update(camera, *sighting);
      target->FollowView(camera, /*learns=*/true);
    }
    if (t_s < 5.0) continue;
    const Vector3d heading =
        target->box().world_from_object.rotation * Vector3d::UnitX();
    largest_rad =
        std::max(largest_rad, std::acos(std::min(1.0, std::abs(heading.y()))));
  }
  return largest_rad;
}

constexpr double kDegree = std::numbers::pi / 180.0;
// Noise of half a pixel turns it by up to 6 degrees; what feeds on itself, by
// more than 30.
constexpr double kSteady_rad = 10.0 * kDegree;

// What is followed is then the car's rear: its heading must not feed on itself.
TEST(GroundTarget, KeepsTheHeadingOfACarThatIsFollowedFromBehind) {
  EXPECT_LT(LargestHeadingError_rad({0.0, -25.0, 12.0}), kSteady_rad);
}

TEST(GroundTarget, KeepsTheHeadingOfACarThatIsSeenFromTheFrontAndTheSide) {
  EXPECT_LT(LargestHeadingError_rad({0.0, 25.0, 12.0}), kSteady_rad);
  EXPECT_LT(LargestHeadingError_rad({25.0, 0.0, 12.0}), kSteady_rad);
}

// Nothing tells the heading of a target that has not moved; then its way does,
// and when it is no longer seen it may turn.
TEST(GroundTarget, SaysHowWellHeadingAndSizeAreKnown) {
  const CameraView camera = ViewFrom({0.0, -25.0, 12.0}, Vector3d::Zero());
  const auto seen_at = [&](double x_m) {
    return *ground::ProjectBodyHull(
        camera.view,
        ground::UprightBox(
            geometry::Plane(), {x_m, 0.0, 0.0}, Vector3d::UnitX(), kCar_m));
  };
  std::chrono::nanoseconds time{0};
  auto target = *GroundTarget::Create(
      camera, seen_at(0.0), time, BoxCenter::kTexture, motion::MotionOptions());
  EXPECT_EQ(target.HeadingSigma_rad(), GroundTarget::kAnyHeading_rad);
  EXPECT_FALSE(target.front_known());
  const double first_sigma_m = std::sqrt(target.SizeCovariance_m2()(0, 0));
  for (int i = 1; i <= 40; ++i) {
    time += std::chrono::milliseconds(40);
    target.Predict(time);
    const auto sighting = target.Lift(camera, seen_at(0.2 * i));
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
  }
  EXPECT_TRUE(target.front_known());
  const double known_rad = target.HeadingSigma_rad();
  EXPECT_LT(known_rad, 20.0 * kDegree);
  EXPECT_LT(std::sqrt(target.SizeCovariance_m2()(0, 0)), first_sigma_m);
  target.Predict(time + std::chrono::seconds(1));
  EXPECT_GT(target.HeadingSigma_rad(), known_rad);
  target.Predict(time + std::chrono::seconds(2));
  EXPECT_LE(target.HeadingSigma_rad(), GroundTarget::kAnyHeading_rad);
}

// A car drives away from a low camera: 2 m/s are about a tenth of its side in
// the picture.
TEST(GroundTarget, WhatDrivesAwayGoesOverTheGroundThoughHardlyInTheImage) {
  const CameraView camera = ViewFrom({0.0, -40.0, 4.0}, Vector3d::Zero());
  const auto seen_at = [&](double y_m) {
    return *ground::ProjectBodyHull(
        camera.view,
        ground::UprightBox(
            geometry::Plane(), {0.0, y_m, 0.0}, Vector3d::UnitY(), kCar_m));
  };
  const auto target = *GroundTarget::Create(camera,
                                            seen_at(0.0),
                                            std::chrono::nanoseconds(0),
                                            BoxCenter::kTexture,
                                            motion::MotionOptions());
  const Eigen::Vector2d velocity_px_s =
      seen_at(2.0).center_px() - seen_at(0.0).center_px();
  constexpr double kRestSides = 0.3;
  ASSERT_LT(velocity_px_s.norm(), kRestSides * std::sqrt(seen_at(0.0).Area()));
  EXPECT_TRUE(target.GoesOverGround(camera, velocity_px_s, 0.5, kRestSides));
  // If that may be the error of how fast it goes in the image, nothing is told.
  EXPECT_FALSE(target.GoesOverGround(
      camera, velocity_px_s, velocity_px_s.norm(), kRestSides));
  EXPECT_FALSE(
      target.GoesOverGround(camera, Eigen::Vector2d::Zero(), 0.5, kRestSides));
}

// It goes 6 m, 2 m/s, as its silhouettes say once its heading is known.
constexpr std::chrono::milliseconds kDrive{3000};
void DriveAsSeen(const CameraView& camera,
                 const std::function<Box2(double way_m)>& seen_at,
                 GroundTarget& target) {
  for (int i = 1; i <= 60; ++i) {
    target.Predict(i * kDrive / 60);
    const Box2 seen = seen_at(0.1 * i);
    const auto sighting = target.Lift(camera, seen);
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
    target.FollowView(camera, /*learns=*/true);
    if (i % 2 == 0 && target.heading_known()) {
      target.SeeSilhouette(camera,
                           {seen, seen, 0.03 * seen.size_px().x()},
                           seen.center_px(),
                           0.1);
    }
  }
}

// A car crosses the view, as its silhouette says again and again; then a lamp
// post behind it is taken for its rear, and its front for shade.
TEST(GroundTarget, ASilhouetteThatIsSuddenlyElsewhereHardlyMovesIt) {
  const CameraView camera = ViewFrom({0.0, -25.0, 8.0}, Vector3d::Zero());
  const auto seen_at = [&](int frame) {
    return *ground::ProjectBodyHull(
        camera.view,
        ground::UprightBox(geometry::Plane(),
                           {0.1 * frame - 3.0, 0.0, 0.0},
                           Vector3d::UnitX(),
                           kCar_m));
  };
  std::chrono::nanoseconds time{0};
  auto target = *GroundTarget::Create(
      camera, seen_at(0), time, BoxCenter::kTexture, motion::MotionOptions());
  for (int i = 1; i <= 60; ++i) {
    time += std::chrono::milliseconds(50);
    target.Predict(time);
    const Box2 seen = seen_at(i);
    const auto sighting = target.Lift(camera, seen);
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
    target.FollowView(camera, /*learns=*/true);
    ground::SeenOutline silhouette{seen, seen, 0.03 * seen.size_px().x()};
    if (i > 56) {
      const double wrong_px = 0.3 * seen.size_px().x();
      silhouette.sure_px.min_px.x() -= wrong_px;
      silhouette.possible_px.min_px.x() = -1e9;
      silhouette.possible_px.max_px.x() -= wrong_px;
      silhouette.sure_px.max_px.x() -= wrong_px;
    }
    if (i % 2 == 0 && target.heading_known()) {
      target.SeeSilhouette(camera, silhouette, seen.center_px(), 0.1);
    }
  }
  const auto outline = target.Project(camera);
  ASSERT_TRUE(outline.has_value());
  const Eigen::Vector2d off = (outline->center_px() - seen_at(60).center_px())
                                  .cwiseQuotient(outline->size_px());
  EXPECT_LT(off.cwiseAbs().maxCoeff(), 0.06) << off.transpose();
}

// Unseen for a while, a car may have turned: its side, much wider than the rear
// that was followed, is its own.
TEST(GroundTarget, WhatTurnedUnseenIsFoundByItsSilhouette) {
  const CameraView camera = ViewFrom({0.0, -25.0, 8.0}, Vector3d::Zero());
  const auto seen_at = [&](double y_m, double turn_rad) {
    const Vector3d heading(std::sin(turn_rad), std::cos(turn_rad), 0.0);
    return *ground::ProjectBodyHull(
        camera.view,
        ground::UprightBox(
            geometry::Plane(), {0.0, y_m, 0.0}, heading, kCar_m));
  };
  auto target = *GroundTarget::Create(camera,
                                      seen_at(-3.0, 0.0),
                                      std::chrono::nanoseconds(0),
                                      BoxCenter::kTexture,
                                      motion::MotionOptions());
  ASSERT_NO_FATAL_FAILURE(DriveAsSeen(
      camera, [&](double way_m) { return seen_at(way_m - 3.0, 0.0); }, target));
  ASSERT_TRUE(target.heading_known());
  const Box2 turned = seen_at(3.1, 0.9);
  ASSERT_GT(turned.size_px().x(), 1.6 * seen_at(3.1, 0.0).size_px().x());
  const ground::SeenOutline silhouette{
      turned, turned, 0.03 * turned.size_px().x()};
  const auto find = [&]() -> std::optional<GroundSighting> {
    Box2 box_px;
    return target.SightBySilhouette(
        camera, silhouette, GroundTarget::Whereabouts::kExpected, box_px);
  };
  // At once it cannot have.
  target.Predict(kDrive + std::chrono::milliseconds(50));
  EXPECT_FALSE(find());
  target.Predict(kDrive + std::chrono::milliseconds(1000));
  EXPECT_TRUE(find());
}

// Looks follow the ground half a car before it. Its silhouette is not believed
// where it was expected, but is where that turned out to be wrong.
TEST(GroundTarget, StandsWhereItsSilhouetteIsOnceItIsKnownToBeElsewhere) {
  const CameraView camera = ViewFrom({0.0, -25.0, 8.0}, Vector3d::Zero());
  const auto seen_at = [&](double x_m, double length_m = 4.5) {
    return *ground::ProjectBodyHull(camera.view,
                                    ground::UprightBox(geometry::Plane(),
                                                       {x_m, 0.0, 0.0},
                                                       Vector3d::UnitX(),
                                                       {length_m, 1.8, 1.5}));
  };
  std::chrono::nanoseconds time{0};
  auto target = *GroundTarget::Create(camera,
                                      seen_at(-3.0),
                                      time,
                                      BoxCenter::kTexture,
                                      motion::MotionOptions());
  ASSERT_NO_FATAL_FAILURE(DriveAsSeen(
      camera, [&](double way_m) { return seen_at(way_m - 3.0); }, target));
  time += kDrive;
  const Box2 truth = seen_at(0.0);
  const ground::SeenOutline there{truth, truth, 0.03 * truth.size_px().x()};
  // It was led on by half of its length.
  for (int i = 1; i <= 10; ++i) {
    time += std::chrono::milliseconds(50);
    target.Predict(time);
    const auto sighting = target.Lift(camera, seen_at(3.0 + 0.1 * i));
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
  }
  using Whereabouts = GroundTarget::Whereabouts;
  Box2 box_px;
  EXPECT_FALSE(
      target.SightBySilhouette(camera, there, Whereabouts::kExpected, box_px));
  const auto found =
      target.SightBySilhouette(camera, there, Whereabouts::kUnknown, box_px);
  ASSERT_TRUE(found.has_value());
  EXPECT_LT((box_px.center_px() - truth.center_px())
                .cwiseQuotient(truth.size_px())
                .norm(),
            0.1);
  target.Restart(*found);
  EXPECT_LT(target.box().BottomCenterWorld().head<2>().norm(), 0.5);
  // A lorry is another thing.
  const Box2 lorry = seen_at(0.0, 8.0);
  EXPECT_FALSE(target.SightBySilhouette(
      camera, {lorry, lorry, 1.0}, Whereabouts::kUnknown, box_px));
}

// It stands still in the image and grows, as where the ground rises towards the
// camera: its outline is as large as it was seen, and a part of that is its
// body's.
TEST(GroundTarget, TheOutlineIsAsLargeAsItIsSeen) {
  const CameraView camera = ViewFrom({0.0, -20.0, 10.0}, Vector3d::Zero());
  const Box2 seen = Box2::FromXywh(600.0, 340.0, 80.0, 60.0);
  std::chrono::nanoseconds time{0};
  auto target = *GroundTarget::Create(
      camera, seen, time, BoxCenter::kTexture, motion::MotionOptions());
  const double length_m = target.box().size_m.x();
  const double width_px = target.Project(camera)->width();
  double growth = 1.0;
  for (int i = 0; i < 60; ++i) {
    time += std::chrono::milliseconds(100);
    target.Predict(time);
    const auto sighting = target.Lift(camera, seen);
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
    target.FollowGrowth(camera, 1.004);
    growth *= 1.004;
  }
  EXPECT_NEAR(
      target.Project(camera)->width() / width_px, growth, 0.05 * growth);
  EXPECT_GT(target.box().size_m.x(), 1.02 * length_m);
  EXPECT_LT(target.box().size_m.x(), growth * length_m);
  const auto about = target.ProjectAbout(camera, {700.0, 300.0});
  EXPECT_TRUE(about->Contains({700.0, 300.0}));
  EXPECT_NEAR(about->width(), target.Project(camera)->width(), 1e-9);
}

// A person seen from 30 degrees above, off the image's middle, who walks to the
// middle: the outline keeps the shape in which it was drawn.
TEST(GroundTarget, ATallOutlineKeepsItsShape) {
  const CameraView camera = ViewFrom({0.0, -12.0, 7.0}, Vector3d::Zero());
  const Box2 seen = Box2::FromXywh(900.0, 300.0, 45.0, 100.0);
  std::chrono::nanoseconds time{0};
  auto target = *GroundTarget::Create(
      camera, seen, time, BoxCenter::kTexture, motion::MotionOptions());
  for (int i = 1; i <= 40; ++i) {
    time += std::chrono::milliseconds(100);
    target.Predict(time);
    const Box2 now = Box2::FromCenter(
        seen.center_px() - Eigen::Vector2d(7.0 * i, 0.0), seen.size_px());
    const auto sighting = target.Lift(camera, now);
    ASSERT_TRUE(sighting.has_value());
    target.Update(camera, *sighting);
    target.FollowView(camera, /*learns=*/true);
  }
  const auto outline = target.Project(camera);
  ASSERT_TRUE(outline.has_value());
  EXPECT_NEAR(outline->width() / outline->height(), 0.45, 1e-6);
  EXPECT_NEAR(outline->height(), 100.0, 20.0);
}

}  // namespace
}  // namespace groundlock::tracking
