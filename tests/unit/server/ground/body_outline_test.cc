// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_outline.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <limits>

#include "server/ground/ground_model.h"

namespace groundlock::ground {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Rigid3;

// A car of 0.9 x 0.5 x 0.35 m, seen from 5 m away, 25 degrees above; it is
// taken to be somewhere else, and of another size.
class BodyOutlineTest : public testing::Test {
 protected:
  static Rigid3 CameraPose(double angle_rad) {
    const Vector3d eye(
        5.0 * std::sin(angle_rad), -5.0 * std::cos(angle_rad), 2.3);
    const Vector3d forward = -eye.normalized();
    const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    return {Eigen::Quaterniond(R), eye};
  }
  SeenOutline Seen(const Rigid3& world_from_camera) const {
    const GroundView view{&camera_, world_from_camera, {}};
    const auto outline_px = *ProjectBodyHull(
        view,
        UprightBox(
            geometry::Plane{}, Vector3d::Zero(), Vector3d::UnitX(), kSize_m),
        BodyShape{});
    return {outline_px, outline_px, 2.0};
  }
  static StandingBody Guess() {
    StandingBody guess;
    guess.world_from_body.translation = {0.1, -0.08, 0.0};
    guess.size_m = {0.75, 0.6, 0.3};
    guess.covariance.diagonal() << 0.02, 0.02, 0.002, 0.05, 0.05, 0.05;
    return guess;
  }
  // The same with shade to the right, in which the body ends somewhere.
  SeenOutline SeenInShade(const Rigid3& world_from_camera) const {
    SeenOutline seen = Seen(world_from_camera);
    seen.sure_px.max_px.x() -= 20.0;
    seen.possible_px.max_px.x() += 20.0;
    return seen;
  }
  // Taken to be where it is.
  static StandingBody InPlace(const Vector3d& size_m) {
    StandingBody body = Guess();
    body.world_from_body.translation.setZero();
    body.size_m = size_m;
    return body;
  }

  const Vector3d kSize_m{0.9, 0.5, 0.35};
  geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     1280,
                                     720,
                                     std::array{1050.0, 640.0, 360.0});
};

TEST_F(BodyOutlineTest, SilhouettesFromAllSidesTellPlaceAndSize) {
  StandingBody body = Guess();
  for (int i = 0; i < 12; ++i) {
    const Rigid3 camera = CameraPose(0.5 * i);
    const auto after =
        FitToOutline(camera_, camera, body, Seen(camera), OutlinePart::kEdges);
    ASSERT_TRUE(after);
    EXPECT_LE(after->covariance.trace(), body.covariance.trace() + 1e-9);
    body = *after;
  }
  EXPECT_LT(body.world_from_body.translation.norm(), 0.02);
  EXPECT_NEAR(body.size_m.x(), kSize_m.x(), 0.04);
  EXPECT_NEAR(body.size_m.y(), kSize_m.y(), 0.04);
  EXPECT_NEAR(body.size_m.z(), kSize_m.z(), 0.03);
  EXPECT_LT(body.surprise, 1.0);
}

TEST_F(BodyOutlineTest, WhereItMayGoOnWithoutEndItTellsNothing) {
  constexpr double kNoEnd = std::numeric_limits<double>::infinity();
  const Rigid3 camera = CameraPose(0.0);
  SeenOutline seen = Seen(camera);
  // Its middle is surely the body.
  const Vector2d middle_px = seen.sure_px.center_px();
  seen.sure_px = {middle_px, middle_px};
  seen.possible_px = {Vector2d::Constant(-kNoEnd), Vector2d::Constant(kNoEnd)};
  for (const OutlinePart part : {OutlinePart::kEdges, OutlinePart::kSize}) {
    const auto after = FitToOutline(camera_, camera, Guess(), seen, part);
    ASSERT_TRUE(after);
    EXPECT_TRUE(after->size_m.isApprox(Guess().size_m));
    EXPECT_TRUE(after->covariance.isApprox(Guess().covariance, 1e-6));
    EXPECT_NEAR(after->surprise, 0.0, 1e-9);
  }
}

TEST_F(BodyOutlineTest, WithinWhatMayBeItEveryPlaceIsAsGood) {
  const Rigid3 camera = CameraPose(0.0);
  const auto after = FitToOutline(camera_,
                                  camera,
                                  InPlace(kSize_m),
                                  SeenInShade(camera),
                                  OutlinePart::kEdges);
  ASSERT_TRUE(after);
  EXPECT_LT(after->world_from_body.translation.norm(), 1e-6);
}

TEST_F(BodyOutlineTest, NoWiderThanWhatMayBeIt) {
  const Rigid3 camera = CameraPose(0.0);
  const auto after = FitToOutline(camera_,
                                  camera,
                                  InPlace({1.3, 0.5, 0.35}),
                                  SeenInShade(camera),
                                  OutlinePart::kSize);
  ASSERT_TRUE(after);
  EXPECT_LT(after->size_m.x(), 1.2);
  EXPECT_GT(after->size_m.x(), kSize_m.x());
}

TEST_F(BodyOutlineTest, ItsSizeIsToldWhereverItStands) {
  const Rigid3 camera = CameraPose(0.0);
  SeenOutline seen = Seen(camera);
  for (auto* box : {&seen.sure_px, &seen.possible_px}) {
    box->min_px.x() += 60.0;
    box->max_px.x() += 60.0;
  }
  const auto after =
      FitToOutline(camera_, camera, InPlace(kSize_m), seen, OutlinePart::kSize);
  ASSERT_TRUE(after);
  EXPECT_TRUE(after->size_m.isApprox(kSize_m, 1e-3));
  EXPECT_NEAR(after->surprise, 0.0, 1e-3);
}

TEST_F(BodyOutlineTest, WhatIsElsewhereSurprises) {
  const Rigid3 camera = CameraPose(0.0);
  SeenOutline seen = Seen(camera);
  for (auto* box : {&seen.sure_px, &seen.possible_px}) {
    box->min_px.x() += 200.0;
    box->max_px.x() += 200.0;
  }
  const auto after =
      FitToOutline(camera_, camera, Guess(), seen, OutlinePart::kEdges);
  ASSERT_TRUE(after);
  EXPECT_GT(after->surprise, 13.3);
}

}  // namespace
}  // namespace groundlock::ground
