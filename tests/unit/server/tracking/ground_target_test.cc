// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/ground_target.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "server/tracking/association.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;
using geometry::Rigid3;

constexpr double kFramesPerSecond = 10.0;
// So slowly that half of its length takes longer than the heading needs to
// follow.
constexpr double kSpeed_m_s = 2.5;
const Vector3d kCar_m(4.5, 1.8, 1.5);

Rigid3 LookAt(const Vector3d& eye, const Vector3d& target) {
  const Vector3d forward = (target - eye).normalized();
  const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  return {Eigen::Quaterniond(R), eye};
}

CameraView ViewFrom(const Vector3d& eye, const Vector3d& target) {
  constexpr std::array<double, 3> kParams = {900.0, 640.0, 360.0};
  static const geometry::CameraModel lens = *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, kParams);
  CameraView camera;
  camera.view.camera = &lens;
  camera.view.world_from_camera = LookAt(eye, target);
  return camera;
}

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
  for (int i = 1; i <= 60; ++i) {
    time += std::chrono::milliseconds(50);
    target.Predict(time);
    const Box2 seen = seen_at(0.1 * i - 3.0);
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

// Hills of 14 m from crest to crest and up to 20 degrees.
std::shared_ptr<const ground::GroundSurface> Hills(
    float height_sigma_m = 0.01F) {
  map::GroundRelief relief;
  relief.columns = 64;
  relief.step = 0.5;
  relief.origin_plane = {-16.0, -16.0};
  for (int row = 0; row < 39; ++row) {
    for (int column = 0; column < 64; ++column) {
      const double x = relief.origin_plane.x() + relief.step * column;
      relief.knots.push_back(
          {static_cast<float>(0.8 *
                              std::sin(2.0 * std::numbers::pi / 14.0 * x)),
           height_sigma_m});
    }
  }
  return ground::MakeReliefSurface({}, relief);
}

// The body stands on the surface, its axis along the surface's normal.
geometry::Box3 Standing(const ground::GroundSurface& surface,
                        const Vector3d& level,
                        const Vector3d& size_m,
                        const Vector3d& heading = Vector3d::UnitX()) {
  const geometry::Plane tangent = surface.At(level)->tangent_world;
  const Vector3d place = level - tangent.SignedDistance(level) /
                                     tangent.normal.z() * Vector3d::UnitZ();
  return ground::UprightBox(tangent, place, heading, size_m);
}

// Up one side of a hill, over the crest and down: taken for level ground its
// place would be metres off, and its size would change by half.
TEST(GroundTarget, DrivesOverHills) {
  const Vector3d kSize_m(0.9, 0.5, 0.35);
  const auto surface = Hills();
  std::optional<GroundTarget> target;
  std::vector<double> errors_m;
  double largest_m = 0.0;
  for (int frame = 0; frame < 100; ++frame) {
    const std::chrono::nanoseconds time = frame * std::chrono::milliseconds(50);
    const Vector3d level(-6.0 + 0.1 * frame, -6.0, 0.0);
    CameraView camera = ViewFrom({-1.0, -11.5, 2.4}, {0.3 * level.x(), -6, 0});
    camera.surface = surface;
    const geometry::Box3 body = Standing(*surface, level, kSize_m);
    const auto seen = ground::ProjectBodyHull(camera.view, body);
    ASSERT_TRUE(seen);
    if (!target) {
      auto created = GroundTarget::Create(
          camera, *seen, time, BoxCenter::kOutline, motion::MotionOptions());
      ASSERT_TRUE(created.ok()) << created.status();
      target.emplace(*std::move(created));
      continue;
    }
    target->Predict(time);
    const auto sighting = target->Lift(camera, *seen);
    ASSERT_TRUE(sighting) << frame;
    target->Update(camera, *sighting);
    const geometry::Box3 box = target->box();
    EXPECT_NEAR(*surface->HeightOf(box.BottomCenterWorld()), 0.0, 1e-3);
    const double error_m =
        (box.BottomCenterWorld() - body.BottomCenterWorld()).norm();
    errors_m.push_back(error_m);
    largest_m = std::max(largest_m, error_m);
    // Along the slope, not level.
    if (frame > 60) {
      EXPECT_NEAR(
          target->velocity_world_m_s().dot(
              surface->At(box.BottomCenterWorld())->tangent_world.normal),
          0.0,
          1e-9);
    }
  }
  std::sort(errors_m.begin(), errors_m.end());
  EXPECT_LT(errors_m[errors_m.size() / 2], 0.05);
  EXPECT_LT(largest_m, 0.15);
}

absl::StatusOr<GroundTarget> StartedIn(const CameraView& camera,
                                       const Box2& box_px) {
  return GroundTarget::Create(camera,
                              box_px,
                              std::chrono::nanoseconds(0),
                              BoxCenter::kTexture,
                              motion::MotionOptions());
}

// Behind it the ground falls and rises again: a ray past it meets that, too,
// and nearer to where coordinates begin.
TEST(GroundTarget, StandsWhereItWasDrawnAndNotOnTheNextHill) {
  const auto surface = Hills();
  CameraView camera = ViewFrom({-15.0, -1.0, 1.6}, {-11.0, -1.0, 0.8});
  camera.surface = surface;
  const geometry::Box3 body =
      Standing(*surface, {-11.0, -1.0, 0.0}, {0.9, 0.5, 0.35});
  const auto drawn = ground::ProjectBodyHull(camera.view, body);
  ASSERT_TRUE(drawn);
  const auto target = StartedIn(camera, *drawn);
  ASSERT_TRUE(target.ok()) << target.status();
  EXPECT_LT(
      (target->box().BottomCenterWorld() - body.BottomCenterWorld()).norm(),
      1.0);
  const auto outline = target->Project(camera);
  ASSERT_TRUE(outline);
  EXPECT_GT(geometry::IntersectionOverUnion(*outline, *drawn), 0.7);
}

// What a crest hides the feet of meets it with its lower edge, whatever ground
// the ray meets far behind.
TEST(GroundTarget, StandsOnTheCrestThatHidesItsFeet) {
  const auto surface = Hills();
  CameraView camera = ViewFrom({-4.0, -6.0, 1.2}, {3.85, -6.0, 0.9});
  camera.surface = surface;
  const auto crest = camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() * Vector3d(3.85, -6.0, 0.79));
  ASSERT_TRUE(crest);
  // A pixel above the crest the ray goes on to the next hill, 18 m away.
  const auto created = StartedIn(camera,
                                 Box2{*crest - Eigen::Vector2d(50.0, 60.0),
                                      *crest + Eigen::Vector2d(50.0, -1.0)});
  ASSERT_TRUE(created.ok()) << created.status();
  EXPECT_NEAR(created->box().BottomCenterWorld().x(), 3.85, 1.0);
}

// Wherever it stands about a crest, seen grazingly: the ground under its middle
// may face away though that at its feet is seen, and is then met far behind, or
// nowhere.
TEST(GroundTarget, StartsNearWhereItStandsAllOverACrest) {
  const auto surface = Hills();
  int starts = 0;
  int far_off = 0;
  const auto start = [&](const Vector3d& eye, double x, double heading_rad) {
    CameraView camera = ViewFrom(eye, {x, -6.0, 0.8});
    camera.surface = surface;
    const geometry::Box3 body =
        Standing(*surface,
                 {x, -6.0, 0.0},
                 {0.9, 0.5, 0.35},
                 {std::cos(heading_rad), std::sin(heading_rad), 0.0});
    const Vector3d place = body.BottomCenterWorld();
    // Not where the crest hides all of its feet.
    const auto before =
        surface->IntersectRay(eye, place - eye, (place - eye).norm());
    if (before && (*before - place).norm() > 0.5) return;
    const auto drawn = ground::ProjectBodyHull(camera.view, body);
    ASSERT_TRUE(drawn);
    const auto target = StartedIn(camera, *drawn);
    ASSERT_TRUE(target.ok()) << target.status();
    const double off_m = (target->box().BottomCenterWorld() - place).norm();
    EXPECT_LT(off_m, 2.5);
    ++starts;
    if (off_m > 1.0) ++far_off;
  };
  for (const double eye_z_m : {1.0, 1.2, 1.4, 1.7}) {
    for (double x = 1.0; x <= 6.0; x += 0.25) {
      for (const double heading_rad : {0.0, 0.8, 1.6, 2.4}) {
        for (const double from_rad : {0.3, 0.7, 1.1, 1.5}) {
          SCOPED_TRACE(
              absl::StrCat("eye ", eye_z_m, ", x ", x, ", from ", from_rad));
          start({x - 7.0 * std::sin(from_rad),
                 -6.0 - 7.0 * std::cos(from_rad),
                 eye_z_m},
                x,
                heading_rad);
        }
      }
    }
  }
  EXPECT_GT(starts, 500);
  EXPECT_LT(far_off, 0.03 * starts);
}

// It drives along a crest, seen grazingly and to three pixels: where the ray
// meets the next slope well is not where it is, however little is known of the
// range.
TEST(GroundTarget, IsNotTakenToTheNextSlopeWhileItIsOnACrest) {
  const auto surface = Hills();
  constexpr double kFrom_m = 7.0;
  std::mt19937 random(1);
  std::normal_distribution<double> noise_px(0.0, 3.0);
  const auto drive = [&](double eye_z_m, double eye_aside_m, double x) {
    std::optional<GroundTarget> target;
    for (int frame = 0; frame < 40; ++frame) {
      const auto time = frame * std::chrono::milliseconds(40);
      const Vector3d level(x, -6.0 + 0.03 * frame, 0.0);
      CameraView camera = ViewFrom(
          {x + eye_aside_m,
           -6.0 - std::sqrt(kFrom_m * kFrom_m - eye_aside_m * eye_aside_m),
           eye_z_m},
          {level.x(), level.y(), 0.8});
      camera.surface = surface;
      const geometry::Box3 body =
          Standing(*surface, level, {0.9, 0.5, 0.35}, Vector3d::UnitY());
      auto seen = ground::ProjectBodyHull(camera.view, body);
      ASSERT_TRUE(seen);
      if (!target) {
        auto created = StartedIn(camera, *seen);
        ASSERT_TRUE(created.ok()) << created.status();
        target.emplace(*std::move(created));
        continue;
      }
      Eigen::Vector2d off_px;
      for (double& axis_px : off_px) axis_px = noise_px(random);
      seen->min_px += off_px;
      seen->max_px += off_px;
      target->Predict(time);
      const auto sighting = target->Lift(camera, *seen);
      if (!sighting || sighting->innovation.surprise > kGate) continue;
      target->Update(camera, *sighting);
      ASSERT_LT(
          (target->box().BottomCenterWorld() - body.BottomCenterWorld()).norm(),
          5.0)
          << frame;
    }
  };
  for (const double eye_aside_m : {-6.5, -5.0, -3.0, 3.0}) {
    for (const double eye_z_m : {0.95, 1.0, 1.1, 1.2, 1.4}) {
      for (const double x : {3.0, 3.5, 4.0, 4.5}) {
        SCOPED_TRACE(
            absl::StrCat("eye ", eye_z_m, ", ", eye_aside_m, " aside, x ", x));
        for (int round = 0; round < 30; ++round) drive(eye_z_m, eye_aside_m, x);
      }
    }
  }
}

// The relief is smoother than the ground, which is higher at the crest: the
// feet are seen above all ground that it has, and stand there all the same.
TEST(GroundTarget, StandsOnACrestThatIsHigherThanItsRelief) {
  const auto surface = Hills();
  CameraView camera = ViewFrom({-4.0, -6.0, 0.95}, {3.85, -6.0, 0.9});
  camera.surface = surface;
  constexpr double kHigher_m = 0.1;
  const auto feet = camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() *
      Vector3d(3.85, -6.0, 0.8 + kHigher_m));
  ASSERT_TRUE(feet);
  const auto created = StartedIn(camera,
                                 Box2{*feet - Eigen::Vector2d(50.0, 60.0),
                                      *feet + Eigen::Vector2d(50.0, 0.0)});
  ASSERT_TRUE(created.ok()) << created.status();
  const Vector3d place = created->box().BottomCenterWorld();
  EXPECT_NEAR(place.x(), 3.85, 1.5);
  EXPECT_NEAR(*surface->HeightOf(place), kHigher_m, 0.06);
  const auto outline = created->Project(camera);
  ASSERT_TRUE(outline);
  EXPECT_NEAR(outline->max_px.y(), feet->y(), 10.0);
}

// The slope on which it was drawn was seen edge-on, or just from below, and
// tells no distance: as if it were level, its way across tells the size.
TEST(GroundTarget, ItsWayTellsTheSizeOfWhatWasDrawnEdgeOn) {
  const Vector3d kSize_m(0.9, 0.5, 0.35);
  const auto surface = Hills();
  for (const double eye_z_m : {1.78, 1.80, 1.85}) {
    std::optional<GroundTarget> target;
    for (int frame = 0; frame < 60; ++frame) {
      const std::chrono::nanoseconds time =
          frame * std::chrono::milliseconds(50);
      const Vector3d level(4.3, -6.8 + 0.06 * frame, 0.0);
      CameraView camera = ViewFrom({-4.0, -6.0, eye_z_m + 0.02 * frame},
                                   {level.x(), level.y(), 0.8});
      camera.surface = surface;
      const auto seen = ground::ProjectBodyHull(
          camera.view, Standing(*surface, level, kSize_m, Vector3d::UnitY()));
      ASSERT_TRUE(seen);
      if (!target) {
        auto created = GroundTarget::Create(
            camera, *seen, time, BoxCenter::kTexture, motion::MotionOptions());
        ASSERT_TRUE(created.ok()) << created.status();
        target.emplace(*std::move(created));
        continue;
      }
      target->Predict(time);
      const auto sighting = target->Lift(camera, *seen);
      ASSERT_TRUE(sighting) << frame;
      target->Update(camera, *sighting);
    }
    EXPECT_TRUE(target->heading_known()) << eye_z_m;
    EXPECT_LT((target->box().size_m - kSize_m).cwiseAbs().maxCoeff(), 0.1)
        << eye_z_m;
  }
}

// A car drives along a crest, seen from below: higher than the relief has it,
// no ray through it meets ground. Its bearing still tells where it is.
TEST(GroundTarget, IsFollowedByItsBearingWhereNoRayMeetsTheGround) {
  const Vector3d kSize_m(0.9, 0.5, 0.35);
  const auto surface = Hills(0.05F);
  std::optional<GroundTarget> target;
  int without_place = 0;
  for (int frame = 0; frame < 60; ++frame) {
    const std::chrono::nanoseconds time = frame * std::chrono::milliseconds(40);
    const double y = -7.5 + 0.05 * frame;
    CameraView camera = ViewFrom({-4.0, -6.0, 1.2}, {3.5, y, 0.9});
    camera.surface = surface;
    // From the crest's near side onto it, and higher and higher.
    const double x = 2.9 + 0.01 * frame;
    geometry::Box3 body = ground::UprightBox(
        surface->At({x, y, 0.0})->tangent_world,
        Vector3d(x, y, 0.8 * std::sin(2.0 * std::numbers::pi / 14.0 * x)),
        Vector3d::UnitY(),
        kSize_m);
    body.world_from_object.translation.z() += 0.0015 * frame;
    const auto seen = ground::ProjectBodyHull(camera.view, body);
    ASSERT_TRUE(seen);
    if (!target) {
      auto created = GroundTarget::Create(
          camera, *seen, time, BoxCenter::kTexture, motion::MotionOptions());
      ASSERT_TRUE(created.ok()) << created.status();
      target.emplace(*std::move(created));
      continue;
    }
    target->Predict(time);
    const auto sighting = target->Lift(camera, *seen);
    ASSERT_TRUE(sighting) << frame;
    if (sighting->is_bearing) ++without_place;
    target->Update(camera, *sighting);
    ASSERT_TRUE(target->ImageCovariance(camera)) << frame;
    const Vector3d off =
        target->box().BottomCenterWorld() - body.BottomCenterWorld();
    EXPECT_LT(std::abs(off.y()), 0.3) << frame;
    EXPECT_LT(std::abs(off.x()), 1.5) << frame;
  }
  EXPECT_GT(without_place, 0);
  // Nothing is where the target cannot be.
  CameraView camera = ViewFrom({-4.0, -6.0, 1.2}, {3.5, -4.5, 0.9});
  camera.surface = surface;
  EXPECT_FALSE(target->Lift(camera, Box2::FromXywh(100.0, 20.0, 90.0, 60.0)));
}

// Unseen for a while, it comes into view far from where it was predicted, with
// hills between: its place is where it is seen, or it has none.
TEST(GroundTarget, IsWhereItIsSeenFarFromWhereItWasPredicted) {
  const Vector3d kSize_m(0.9, 0.5, 0.35);
  const auto surface = Hills();
  CameraView camera = ViewFrom({-6.0, -12.0, 1.3}, {2.0, -5.0, 0.5});
  camera.surface = surface;
  const auto drawn = ground::ProjectBodyHull(
      camera.view, Standing(*surface, {-2.0, -8.0, 0.0}, kSize_m));
  ASSERT_TRUE(drawn);
  int placed = 0;
  for (double x = -4.0; x <= 9.0; x += 0.5) {
    for (double y = -9.0; y <= 1.0; y += 0.5) {
      const auto seen = ground::ProjectBodyHull(
          camera.view, Standing(*surface, {x, y, 0.0}, kSize_m));
      if (!seen) continue;
      auto target = StartedIn(camera, *drawn);
      ASSERT_TRUE(target.ok()) << target.status();
      target->Predict(std::chrono::seconds(8));
      const auto sighting = target->Lift(camera, *seen);
      if (!sighting) continue;
      ++placed;
      target->Restart(*sighting);
      const auto outline = target->ProjectForTracker(camera);
      ASSERT_TRUE(outline) << x << ", " << y;
      EXPECT_LT((outline->center_px() - seen->center_px()).norm(),
                0.3 * std::sqrt(seen->Area()))
          << x << ", " << y;
    }
  }
  EXPECT_GT(placed, 100);
}

}  // namespace
}  // namespace groundlock::tracking
