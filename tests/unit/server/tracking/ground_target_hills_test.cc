// SPDX-License-Identifier: Apache-2.0
// Targets on ground that is no plane: hills, and their crests above all.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "server/tracking/association.h"
#include "server/tracking/ground_errors.h"
#include "server/tracking/ground_target.h"
#include "tests/unit/server/tracking/views_of_ground.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;

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

// The farthest that points of a car have it off its place, on hills that are a
// few centimetres higher than they are said to be.
double FarthestByPoints_m(float height_sigma_m) {
  const Vector3d kSize_m(0.9, 0.5, 0.35);
  const Vector3d kRise(0.0, 0.0, 0.05);
  const auto surface = Hills(height_sigma_m);
  std::optional<GroundTarget> target;
  double farthest_m = 0.0;
  for (int frame = 0; frame < 80; ++frame) {
    const std::chrono::nanoseconds time = frame * std::chrono::milliseconds(50);
    const Vector3d level(-6.0 + 0.05 * frame, -6.0, 0.0);
    CameraView camera = ViewFrom({-1.0, -11.5, 1.6}, {0.3 * level.x(), -6, 0});
    camera.surface = surface;
    geometry::Box3 body = Standing(*surface, level, kSize_m);
    body.world_from_object.translation += kRise;
    Box2 box_px = *ground::ProjectBodyHull(camera.view, body);
    if (!target) {
      target = *GroundTarget::Create(
          camera, box_px, time, BoxCenter::kTexture, motion::MotionOptions());
      continue;
    }
    target->Predict(time);
    std::optional<GroundSighting> sighting;
    if (frame < 40) {
      sighting = target->Lift(camera, box_px);
    } else {
      std::vector<ground::BodySighting> seen;
      for (const double along : {-0.45, -0.2, 0.1, 0.45}) {
        for (const double high : {0.05, 0.2, 0.35}) {
          const Vector3d p_body(along, -0.25, high);
          const geometry::Rigid3 world_from_body{
              body.world_from_object.rotation, body.BottomCenterWorld()};
          seen.push_back({p_body,
                          *camera.view.camera->ImageFromCamera(
                              camera.view.world_from_camera.Inverse() *
                              (world_from_body * p_body))});
        }
      }
      std::vector<bool> agrees;
      sighting =
          target->SightByPoints(camera, seen, std::nullopt, box_px, agrees);
    }
    if (!sighting) {
      ADD_FAILURE() << "not sighted in frame " << frame;
      return farthest_m;
    }
    target->Update(camera, *sighting);
    if (frame < 60) continue;
    farthest_m = std::max(
        farthest_m,
        (target->box().BottomCenterWorld() - body.BottomCenterWorld()).norm());
  }
  return farthest_m;
}

TEST(GroundTarget, GoesByItsSizeWhereTheGroundIsHigherThanItIsSaidToBe) {
  EXPECT_GT(FarthestByPoints_m(0.0F), 0.15);
  EXPECT_LT(FarthestByPoints_m(0.04F), 0.05);
}

TEST(GroundErrors, BecomeOthersOnTheWay) {
  const Eigen::Vector3d sigmas(0.05, 0.1, 0.1);
  const Eigen::Vector3d first(0.08, 0.1, -0.2);
  GroundErrors errors{first, 1e-4 * Eigen::Matrix3d::Identity()};
  errors.GoOn(0.0, sigmas);
  EXPECT_EQ(errors.mean, first);
  EXPECT_EQ(errors.covariance(0, 0), 1e-4);
  errors.GoOn(0.5, sigmas);
  EXPECT_NEAR((errors.mean - std::exp(-0.5) * first).norm(), 0.0, 1e-12);
  EXPECT_GT(errors.covariance(0, 0), 1e-4);
  errors.GoOn(20.0, sigmas);
  EXPECT_NEAR(errors.mean.norm(), 0.0, 1e-9);
  EXPECT_NEAR(
      (errors.covariance.diagonal() - sigmas.cwiseAbs2()).norm(), 0.0, 1e-9);
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
  int told = 0;
  int wrong = 0;
  double off_sigmas2 = 0.0;
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
      const bool was_known = target->front_known();
      target->Update(camera, *sighting);
      ASSERT_LT(
          (target->box().BottomCenterWorld() - body.BottomCenterWorld()).norm(),
          5.0)
          << frame;
      if (was_known || !target->front_known()) continue;
      const Vector3d heading =
          target->box().world_from_object.rotation * Vector3d::UnitX();
      const double off_rad = std::abs(std::atan2(heading.x(), heading.y()));
      ++told;
      wrong += off_rad > 0.7 ? 1 : 0;
      off_sigmas2 += std::pow(off_rad / target->HeadingSigma_rad(), 2);
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
  // Of its range a way says nothing there. Of 2,400 drives 2,333 told a
  // heading, 353 of them a wrong one, while the height of what is followed was
  // taken for known.
  EXPECT_GT(told, 1800);
  EXPECT_LT(wrong, told / 50);
  EXPECT_LT(off_sigmas2 / told, 2.0);
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
        auto created = StartedIn(camera, *seen);
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
      auto created = StartedIn(camera, *seen);
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

// It stands on a crest, over which its ray goes on to the next hill. Taken to
// be there, it is looked for there, 2.5 times as small; what is found is as
// large as it is on the crest.
TEST(GroundTarget, WhatIsFoundOnACrestIsNotOnTheNextHill) {
  const auto surface = Hills();
  CameraView camera = ViewFrom({-4.0, -6.0, 1.4}, {3.2, -6.0, 0.9});
  camera.surface = surface;
  const geometry::Box3 body =
      Standing(*surface, {3.2, -6.0, 0.0}, {0.9, 0.5, 0.35}, Vector3d::UnitY());
  const auto seen = ground::ProjectBodyHull(camera.view, body);
  ASSERT_TRUE(seen);
  auto target = *GroundTarget::Create(camera,
                                      *seen,
                                      std::chrono::nanoseconds(0),
                                      BoxCenter::kTexture,
                                      motion::MotionOptions());
  const Eigen::Vector2d there_m = target.Lift(camera, *seen)->place_m;
  // The next slope that faces the camera.
  GroundSighting behind = *target.Lift(camera, *seen);
  behind.place_m += Eigen::Vector2d(11.5, 0.0);
  target.Restart(behind);
  const auto lifted = target.Lift(camera, *seen);
  ASSERT_TRUE(lifted);
  ASSERT_GT((lifted->place_m - there_m).norm(), 5.0);
  const auto found = target.LiftAsLarge(camera, *seen);
  ASSERT_TRUE(found);
  EXPECT_LT((found->place_m - there_m).norm(), 0.1);
  EXPECT_EQ(target.BoxAsLarge(camera, *seen).min_px, seen->min_px);
  // As small as that is far away, it is behind.
  const auto far_px = target.ProjectForTracker(camera);
  ASSERT_TRUE(far_px);
  ASSERT_LT(far_px->Area(), 0.3 * seen->Area());
  const auto far = target.LiftAsLarge(camera, *far_px);
  ASSERT_TRUE(far);
  EXPECT_LT((far->place_m - behind.place_m).norm(), 1.0);
}

}  // namespace
}  // namespace groundlock::tracking
