// SPDX-License-Identifier: Apache-2.0
#include "server/ground/ground_model.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>

#include "server/ground/box_fit.h"

namespace groundlock::ground {
namespace {

using geometry::Box2;
using geometry::Box3;
using geometry::CameraModel;

CameraModel TestCamera() {
  const std::array<double, 4> params = {1050.0, 640.0, 360.0, -0.045};
  return *CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial, 1280, 720, params);
}

// At the given height over z = 0, looking along +y, tilted down, then rolled.
GroundView ViewAt(const CameraModel& camera,
                  double height_m,
                  double down_rad,
                  double roll_rad = 0.0) {
  Eigen::Matrix3d level;
  level << Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitZ(),
      Eigen::Vector3d::UnitY();
  GroundView view;
  view.camera = &camera;
  view.world_from_camera.rotation =
      Eigen::Quaterniond(level) *
      Eigen::AngleAxisd(-down_rad, Eigen::Vector3d::UnitX()) *
      Eigen::AngleAxisd(roll_rad, Eigen::Vector3d::UnitZ());
  view.world_from_camera.translation = {0.0, 0.0, height_m};
  return view;
}

TEST(GroundFromImage, InvertsProjection) {
  const CameraModel camera = TestCamera();
  const GroundView view = ViewAt(camera, 1.6, 0.3, 0.1);
  const Eigen::Vector3d p_world(0.7, 6.0, 0.0);
  const auto pixel =
      camera.ImageFromCamera(view.world_from_camera.Inverse() * p_world);
  ASSERT_TRUE(pixel);
  const auto p = GroundFromImage(view, *pixel);
  ASSERT_TRUE(p);
  // The lens is inverted to 1e-9 px-normalised; 6 m away at 15 degrees.
  EXPECT_LT((*p - p_world).norm(), 1e-6);
}

TEST(GroundFromImage, NothingAboveTheHorizonOrBelowTheGround) {
  const CameraModel camera = TestCamera();
  EXPECT_FALSE(GroundFromImage(ViewAt(camera, 1.6, 0.0), {640.0, 300.0}));
  EXPECT_FALSE(GroundFromImage(ViewAt(camera, 1.6, 0.0), {640.0, 360.5}));
  EXPECT_FALSE(GroundFromImage(ViewAt(camera, -1.6, 0.3), {640.0, 600.0}));
  EXPECT_FALSE(GroundFromImage(ViewAt(camera, 0.0, 0.3), {640.0, 600.0}));
}

TEST(LiftBox, InvertsTheFrontProjection) {
  const std::array<double, 3> params = {1050.0, 640.0, 360.0};
  const auto camera = *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, params);
  const GroundView view = ViewAt(camera, 1.6, 0.25);
  // Straight ahead the box's edges are the front face's.
  const Eigen::Vector3d p_world(0.0, 5.0, 0.0);
  const auto box_px = ProjectBoxFront(view, p_world, 0.5, 0.35);
  ASSERT_TRUE(box_px);
  const auto box = LiftBox(view, *box_px);
  ASSERT_TRUE(box.ok()) << box.status();
  EXPECT_NEAR(box->size_m.z(), 0.35, 0.02);  // the upper edge is a bit wider
  EXPECT_NEAR(box->size_m.x(), 0.5, 0.03);
  EXPECT_LT((box->BottomCenterWorld() - p_world).norm(), 0.03);
}

TEST(LiftBox, Degenerate) {
  const CameraModel camera = TestCamera();
  const GroundView level = ViewAt(camera, 1.6, 0.0);
  EXPECT_EQ(LiftBox(level, Box2::FromXywh(600, 100, 80, 80)).status().code(),
            absl::StatusCode::kOutOfRange);
  EXPECT_EQ(LiftBox(level, Box2::FromXywh(600, 400, 0, 80)).status().code(),
            absl::StatusCode::kInvalidArgument);
  // From straight above: no front face, and no crash.
  const GroundView nadir = ViewAt(camera, 20.0, std::numbers::pi / 2);
  EXPECT_FALSE(LiftBox(nadir, Box2::FromXywh(600, 320, 80, 80)).ok());
}

TEST(ProjectBox, NothingBehindTheCamera) {
  const CameraModel camera = TestCamera();
  const GroundView view = ViewAt(camera, 1.6, 0.2);
  const Eigen::Vector3d behind(0.0, -5.0, 0.0);
  EXPECT_FALSE(ProjectBoxFront(view, behind, 0.5, 0.35));
  const Box3 box = UprightBox(
      view.ground_world, behind, Eigen::Vector3d::UnitX(), {0.9, 0.5, 0.35});
  EXPECT_FALSE(ProjectBoxHull(view, box));
  EXPECT_FALSE(ProjectBodyHull(view, box));
  EXPECT_FALSE(ProjectBody(view, box));
}

// What a body takes of the image touches all sides of its hull, and leaves the
// upper corners empty, for it narrows towards the top.
TEST(ProjectBox, ABodyDoesNotFillItsHull) {
  const CameraModel camera = TestCamera();
  const GroundView view = ViewAt(camera, 1.6, 0.2);
  const Box3 box = UprightBox(view.ground_world,
                              {-0.4, 7.0, 0.0},
                              Eigen::Vector3d(0.6, 0.8, 0.0),
                              {0.9, 0.5, 0.35});
  const Box2 hull_px = *ProjectBodyHull(view, box);
  const geometry::ConvexPolygon body_px = *ProjectBody(view, box);
  EXPECT_EQ(body_px.Bounds().min_px, hull_px.min_px);
  EXPECT_EQ(body_px.Bounds().max_px, hull_px.max_px);
  EXPECT_TRUE(body_px.Contains(hull_px.center_px()));
  const Eigen::Vector2d inset_px(1.0, 1.0);
  EXPECT_FALSE(body_px.Contains(hull_px.min_px + inset_px));
  EXPECT_FALSE(body_px.Contains({hull_px.max_px.x() - 1.0, hull_px.y() + 1.0}));
}

TEST(ScaleFromDistance, RecedingTargetShrinks) {
  EXPECT_DOUBLE_EQ(ScaleFromDistance(5.0, 10.0), 0.5);
}

TEST(PlaceBox, ByCenterAndByPointInvertTheirProjections) {
  const CameraModel camera = TestCamera();
  const Eigen::Vector3d size_m(0.9, 0.5, 0.35);
  const Eigen::Vector3d heading(0.6, 0.8, 0.0);
  const Eigen::Vector3d p_world(-0.4, 7.0, 0.0);
  for (const double roll : {0.0, 0.4}) {
    const GroundView view = ViewAt(camera, 1.6, 0.25, roll);
    const Box3 box = UprightBox(view.ground_world, p_world, heading, size_m);
    const auto hull = ProjectBodyHull(view, box);
    ASSERT_TRUE(hull);
    const auto by_center = PlaceBoxByCenter(
        view, hull->center_px(), heading, size_m, {0.0, 4.0, 0.0});
    ASSERT_TRUE(by_center);
    EXPECT_LT((by_center->box.BottomCenterWorld() - p_world).norm(), 1e-6);
    const Eigen::Vector3d p_object =
        PointOnRay(view, box, hull->center_px(), 0.8);
    const auto pixel = camera.ImageFromCamera(
        view.world_from_camera.Inverse() * (box.world_from_object * p_object));
    ASSERT_TRUE(pixel);
    // The point lies on the ray through the pixel.
    EXPECT_LT((*pixel - hull->center_px()).norm(), 1e-6);
    const auto by_point =
        PlaceBoxByPoint(view, *pixel, heading, size_m, p_object);
    ASSERT_TRUE(by_point);
    EXPECT_LT((by_point->box.BottomCenterWorld() - p_world).norm(), 1e-6);
  }
}

TEST(FitBox, ReproducesTheImageBoxAlsoFromAboveAndRolled) {
  const CameraModel camera = TestCamera();
  for (const double down : {0.25, 0.8, std::numbers::pi / 2}) {
    for (const double roll : {0.0, 0.3}) {
      const GroundView view = ViewAt(camera, 6.0, down, roll);
      const auto p = GroundFromImage(view, {660.0, 420.0});
      ASSERT_TRUE(p);
      const Box3 truth =
          UprightBox(view.ground_world, *p, {0.3, 1.0, 0.0}, {0.9, 0.5, 0.35});
      const auto box_px = ProjectBodyHull(view, truth);
      ASSERT_TRUE(box_px);
      const auto fitted = FitBox(view,
                                 *box_px,
                                 Eigen::Vector3d(0.3, 1.0, 0.0),
                                 {.length_over_width = 1.8, .tallness = 0.52});
      ASSERT_TRUE(fitted.ok()) << fitted.status() << " down " << down;
      // The prior agrees with the truth, so only numerics remain.
      EXPECT_LT((fitted->size_m - truth.size_m).norm(), 0.03);
      EXPECT_LT((fitted->BottomCenterWorld() - *p).norm(), 0.03);
    }
  }
  EXPECT_FALSE(FitBox(ViewAt(camera, 1.6, 0.0),
                      Box2::FromXywh(600, 100, 80, 80),
                      std::nullopt,
                      {})
                   .ok());
}

// What is believed of any target's shape, as tracking has it.
constexpr ShapePrior kAnyShape{.length_over_width = 1.0,
                               .length_over_width_sigma = 0.4,
                               .tallness = 0.7,
                               .tallness_sigma = 0.8};

TEST(FitBox, FromAboveABodyMayStandAnyWay) {
  const CameraModel camera = TestCamera();
  const GroundView view = ViewAt(camera, 8.0, std::numbers::pi / 2);
  for (int degrees = 0; degrees < 180; degrees += 15) {
    const double heading_rad = degrees * std::numbers::pi / 180.0;
    for (const double x : {-2.0, 0.0, 1.5}) {
      const Box3 truth =
          UprightBox(view.ground_world,
                     {x, 1.4, 0.0},
                     {std::cos(heading_rad), std::sin(heading_rad), 0.0},
                     {0.9, 0.5, 0.35});
      const auto box_px = ProjectBodyHull(view, truth);
      ASSERT_TRUE(box_px);
      const auto fitted = FitBox(view, *box_px, std::nullopt, kAnyShape);
      ASSERT_TRUE(fitted.ok()) << fitted.status() << degrees;
      // No thin bar, no pole. The box does not tell a body from one that is
      // turned the other way, nor how tall it is.
      EXPECT_GT(fitted->size_m.minCoeff(), 0.25) << degrees << " at " << x;
      EXPECT_LT(fitted->size_m.maxCoeff(), 1.1) << degrees << " at " << x;
      EXPECT_LT(
          (fitted->BottomCenterWorld() - truth.BottomCenterWorld()).norm(),
          0.12)
          << degrees << " at " << x;
    }
  }
}

TEST(FitBox, FromACameraThatRollsItIsNoPole) {
  const CameraModel camera = TestCamera();
  for (const double roll_rad : {-0.55, 0.55}) {
    const GroundView view = ViewAt(camera, 3.5, 0.6, roll_rad);
    const auto p_world = GroundFromImage(view, {560.0, 380.0});
    ASSERT_TRUE(p_world);
    const Box3 truth = UprightBox(
        view.ground_world, *p_world, {0.4, 1.0, 0.0}, {0.9, 0.5, 0.35});
    const auto box_px = ProjectBodyHull(view, truth);
    ASSERT_TRUE(box_px);
    const auto fitted = FitBox(view, *box_px, std::nullopt, kAnyShape);
    ASSERT_TRUE(fitted.ok()) << fitted.status();
    EXPECT_LT(fitted->size_m.z(), 0.7);
    EXPECT_LT((fitted->BottomCenterWorld() - *p_world).norm(), 0.2);
  }
}

TEST(GroundCovarianceFromPose, MatchesAPerturbedPose) {
  const CameraModel camera = TestCamera();
  const GroundView view = ViewAt(camera, 1.6, 0.25);
  const Eigen::Vector2d pixel(700.0, 420.0);
  const Eigen::Vector3d p = *GroundFromImage(view, pixel);
  for (int k = 0; k < 6; ++k) {
    const double step = 1e-5;
    GroundView moved = view;
    if (k < 3) {
      moved.world_from_camera.translation[k] += step;
    } else {
      moved.world_from_camera.rotation =
          geometry::QuaternionFromRotationVector(step *
                                                 Eigen::Vector3d::Unit(k - 3)) *
          view.world_from_camera.rotation;
    }
    const Eigen::Vector2d change =
        (*GroundFromImage(moved, pixel) - p).head<2>() / step;
    geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
    covariance(k, k) = 1.0;
    const Eigen::Matrix2d on_ground =
        GroundCovarianceFromPose(view, p, covariance);
    // Second order of a 1e-5 step at 6 m.
    EXPECT_LT((on_ground - change * change.transpose()).norm(),
              1e-2 * std::max(1.0, on_ground.norm()));
  }
}

}  // namespace
}  // namespace groundlock::ground
