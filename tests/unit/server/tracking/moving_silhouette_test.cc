// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/moving_silhouette.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "server/tracking/target_silhouette.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;
using geometry::Box3;
using std::chrono::milliseconds;

// A red car of 0.9 x 0.5 x 0.35 m goes 1 m/s along the ground z = 0; a camera
// goes by, 5 m away.
class MovingSilhouetteTest : public testing::Test {
 protected:
  struct Scene {
    bool has_texture = true;
    double shade_m = 0.0;  // beyond its front, on the ground
    double half_shade_width_m = 0.25;
    bool shows_in_shade = true;  // the texture
    bool another = false;        // comes from the left and touches it
    double asked_s = 1.5;
    bool body = true;
  };

  CameraView CameraAt(double time_s) const {
    const Vector3d eye(-0.5 + 0.3 * time_s, -5.0, 2.0);
    const Vector3d forward = (Vector3d(0.3, 0.0, 0.0) - eye).normalized();
    const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    CameraView camera;
    camera.view = {&camera_, {Eigen::Quaterniond(R), eye}, geometry::Plane{}};
    return camera;
  }
  static Box3 BodyAt(double time_s, double length_m = 0.9) {
    return ground::UprightBox(geometry::Plane{},
                              {time_s - 0.8, 0.0, 0.0},
                              Vector3d::UnitX(),
                              {length_m, 0.5, 0.35});
  }
  static Box2 Outline(const CameraView& camera, const Box3& body) {
    return *ground::ProjectBodyHull(
        camera.view, body, {.plan = 1.0, .roof = 1.0, .clearance = 0.0});
  }

  // Of the ground: as bright as chance has it every 8 cm, smooth between.
  static double Brightness(const Eigen::Vector2d& p_m) {
    const auto at = [](double i, double j) {
      std::uint32_t mixed =
          static_cast<std::uint32_t>(static_cast<std::int32_t>(i)) *
              2654435761U ^
          static_cast<std::uint32_t>(static_cast<std::int32_t>(j)) *
              2246822519U;
      mixed ^= mixed >> 15;
      mixed *= 2246822519U;
      mixed ^= mixed >> 13;
      return 130.0 + 60.0 * (mixed % 1024 / 512.0 - 1.0);
    };
    const Eigen::Array2d cell = p_m.array() / 0.08;
    const Eigen::Array2d first = cell.floor();
    const Eigen::Array2d share = cell - first;
    const auto row = [&](double j) {
      return (1.0 - share.x()) * at(first.x(), j) +
             share.x() * at(first.x() + 1.0, j);
    };
    return (1.0 - share.y()) * row(first.y()) +
           share.y() * row(first.y() + 1.0);
  }

  image::Frame FrameAt(double time_s, const Scene& scene) {
    const CameraView camera = CameraAt(time_s);
    cv::Mat bgr(360, 640, CV_8UC3);
    const double front_m = time_s - 0.8 + 0.45;
    std::normal_distribution<double> noise(0.0, 2.0);
    for (int y = 0; y < bgr.rows; ++y) {
      for (int x = 0; x < bgr.cols; ++x) {
        const auto p_world =
            ground::GroundFromImage(camera.view, {x + 0.5, y + 0.5});
        double level = 130.0;
        if (p_world && scene.has_texture)
          level = Brightness(p_world->head<2>());
        if (p_world && p_world->x() > front_m &&
            p_world->x() < front_m + scene.shade_m &&
            std::abs(p_world->y()) < scene.half_shade_width_m) {
          level = 0.5 * (scene.shows_in_shade ? level : 130.0);
        }
        level += noise(random_);
        bgr.at<cv::Vec3b>(y, x) =
            cv::Vec3b::all(cv::saturate_cast<uchar>(level));
      }
    }
    if (scene.body) Draw(camera, BodyAt(time_s), {40, 40, 200}, bgr);
    if (scene.another) {
      Draw(camera,
           ground::UprightBox(geometry::Plane{},
                              {2.0 * time_s - 3.2, 0.0, 0.0},
                              Vector3d::UnitX(),
                              {1.7, 0.5, 0.35}),
           {220, 220, 220},
           bgr);
    }
    image::Frame frame = image::Frame::FromBgr(bgr);
    frame.capture_time = std::chrono::milliseconds(std::lround(1e3 * time_s));
    return frame;
  }
  static void Draw(const CameraView& camera,
                   const Box3& body,
                   const cv::Scalar& colour,
                   cv::Mat& bgr) {
    std::vector<cv::Point2f> corners;
    for (const Vector3d& p_world : body.CornersWorld()) {
      const Eigen::Vector2d pixel = *camera.view.camera->ImageFromCamera(
          camera.view.world_from_camera.Inverse() * p_world);
      corners.emplace_back(pixel.x() - 0.5, pixel.y() - 0.5);
    }
    std::vector<cv::Point2f> hull;
    cv::convexHull(corners, hull);
    std::vector<cv::Point> polygon(hull.begin(), hull.end());
    cv::fillConvexPoly(bgr, polygon, colour);
  }

  // As it is then, but asked for a tenth of its size off.
  std::optional<ground::SeenOutline> Measure(const Scene& scene) {
    const auto seen = MeasureOff(scene, {0.1, 0.1});
    if (!seen) return std::nullopt;
    EXPECT_FALSE(seen->stands_beside);
    return seen->outline;
  }
  std::optional<MovingSilhouette::Silhouette> MeasureOff(
      const Scene& scene, const Eigen::Vector2d& off) {
    MovingSilhouette silhouette;
    for (double t = 0.0; t < scene.asked_s - 0.05; t += 0.1) {
      const CameraView camera = CameraAt(t);
      const Box3 body = BodyAt(t);
      silhouette.Keep(FrameAt(t, scene),
                      camera,
                      Outline(camera, body),
                      body.BottomCenterWorld(),
                      0.67);
    }
    const CameraView camera = CameraAt(scene.asked_s);
    truth_px_ = Outline(camera, BodyAt(scene.asked_s));
    const Eigen::Vector2d off_px = off.cwiseProduct(truth_px_.size_px());
    return silhouette.Measure(
        FrameAt(scene.asked_s, scene),
        camera,
        geometry::Plane{},
        {truth_px_.min_px + off_px, truth_px_.max_px + off_px});
  }

  geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     640,
                                     360,
                                     std::array{525.0, 320.0, 180.0});
  std::mt19937_64 random_{7};
  Box2 truth_px_;
};

TEST_F(MovingSilhouetteTest, TellsAllEdgesOfWhatGoesOverTexturedGround) {
  const auto seen = Measure({});
  ASSERT_TRUE(seen);
  EXPECT_EQ(seen->is_seen, (std::array<bool, 4>{true, true, true, true}));
  EXPECT_LT((seen->sure_px.min_px - truth_px_.min_px).cwiseAbs().maxCoeff(),
            3.0);
  EXPECT_LT((seen->sure_px.max_px - truth_px_.max_px).cwiseAbs().maxCoeff(),
            3.0);
}

TEST_F(MovingSilhouetteTest, GroundInTheShadeIsGroundWhereItShowsItsTexture) {
  const auto seen = Measure({.shade_m = 0.5});
  ASSERT_TRUE(seen);
  EXPECT_LT(std::abs(seen->sure_px.max_px.x() - truth_px_.max_px.x()), 4.0);
}

// As it drives after its shade, no earlier picture shows what comes out behind
// it in the sun.
TEST_F(MovingSilhouetteTest, GroundThatLayInItsShadeIsNoPartOfIt) {
  const auto seen = Measure({.shade_m = 1.0, .asked_s = 1.6});
  ASSERT_TRUE(seen);
  EXPECT_LT(std::abs(seen->sure_px.min_px.x() - truth_px_.min_px.x()), 4.0);
}

TEST_F(MovingSilhouetteTest, OnlyShadeInMostRowsLeavesAnEdgeOpen) {
  Scene scene{.shade_m = 0.5, .shows_in_shade = false};
  auto seen = Measure(scene);
  ASSERT_TRUE(seen);
  EXPECT_FALSE(seen->is_seen[2]);
  EXPECT_GT(seen->possible_px.max_px.x(), truth_px_.max_px.x() + 15.0);
  scene.half_shade_width_m = 0.06;
  seen = Measure(scene);
  ASSERT_TRUE(seen);
  EXPECT_TRUE(seen->is_seen[2]);
  EXPECT_LT(std::abs(seen->sure_px.max_px.x() - truth_px_.max_px.x()), 4.0);
}

TEST_F(MovingSilhouetteTest, BareGroundMayBeABodyOfItsColour) {
  const auto seen = Measure({.has_texture = false});
  ASSERT_TRUE(seen);
  EXPECT_EQ(seen->is_seen, (std::array<bool, 4>{false, false, false, false}));
  // Surely no larger than it is.
  EXPECT_GT(seen->sure_px.min_px.x(), truth_px_.min_px.x() - 3.0);
  EXPECT_LT(seen->sure_px.max_px.x(), truth_px_.max_px.x() + 3.0);
}

TEST_F(MovingSilhouetteTest, AnEdgeThatAnotherTouchesIsNotSeen) {
  const auto seen = Measure({.another = true});
  ASSERT_TRUE(seen);
  EXPECT_FALSE(seen->is_seen[0]);
  EXPECT_TRUE(seen->is_seen[2]);
  EXPECT_LT(std::abs(seen->sure_px.max_px.x() - truth_px_.max_px.x()), 3.0);
}

// It overtakes: both are one silhouette, which goes on beyond what is looked
// at.
TEST_F(MovingSilhouetteTest, WhatAnotherAddsIsNotSurelyItsOwn) {
  const auto seen = Measure({.another = true, .asked_s = 1.7});
  ASSERT_TRUE(seen);
  EXPECT_FALSE(seen->is_seen[0]);
  EXPECT_GT(seen->sure_px.min_px.x(), truth_px_.min_px.x() - 4.0);
  EXPECT_LT(std::abs(seen->sure_px.max_px.x() - truth_px_.max_px.x()), 3.0);
}

// What was followed is the ground before it, which looks as it did before.
TEST_F(MovingSilhouetteTest, FindsOneThatStandsBesideWhereItIsExpected) {
  const auto seen = MeasureOff({}, {0.6, 0.0});
  ASSERT_TRUE(seen);
  EXPECT_TRUE(seen->stands_beside);
  const ground::SeenOutline& outline = seen->outline;
  EXPECT_LT((outline.sure_px.min_px - truth_px_.min_px).cwiseAbs().maxCoeff(),
            3.0);
  EXPECT_LT((outline.sure_px.max_px - truth_px_.max_px).cwiseAbs().maxCoeff(),
            3.0);
}

// The ground that it has only just left was seen too seldom to tell.
TEST_F(MovingSilhouetteTest, IsNotBesideWhereTheGroundIsUnknown) {
  EXPECT_FALSE(MeasureOff({}, {-0.6, 0.0}));
}

// Nothing else tells how the ground looks where a body comes back.
TEST_F(MovingSilhouetteTest, PicturesWithoutItShowTheGroundWhereItComesBack) {
  MovingSilhouette silhouette;
  const CameraView camera = CameraAt(1.0);
  const Box2 outline_px = Outline(camera, BodyAt(1.0));
  const Scene empty{.body = false};
  silhouette.KeepWithout(FrameAt(0.0, empty), CameraAt(0.0), outline_px);
  silhouette.KeepWithout(FrameAt(0.5, empty), CameraAt(0.5), outline_px);
  // That one came too early: a single picture may show the body itself.
  EXPECT_FALSE(silhouette.Measure(
      FrameAt(1.0, {}), camera, geometry::Plane{}, outline_px));
  silhouette.KeepWithout(FrameAt(1.0, empty), camera, outline_px);
  const CameraView later = CameraAt(1.1);
  const Box2 later_px = Outline(later, BodyAt(1.1));
  const auto seen =
      silhouette.Measure(FrameAt(1.1, {}), later, geometry::Plane{}, later_px);
  ASSERT_TRUE(seen);
  EXPECT_LT(
      (seen->outline.sure_px.min_px - later_px.min_px).cwiseAbs().maxCoeff(),
      3.0);
  EXPECT_LT(
      (seen->outline.sure_px.max_px - later_px.max_px).cwiseAbs().maxCoeff(),
      3.0);
}

TEST_F(MovingSilhouetteTest, TellsNothingWithoutPicturesOrWherePosesBeginAnew) {
  MovingSilhouette silhouette;
  CameraView camera = CameraAt(1.5);
  const Box2 outline_px = Outline(camera, BodyAt(1.5));
  const image::Frame frame = FrameAt(1.5, {});
  EXPECT_FALSE(
      silhouette.Measure(frame, camera, geometry::Plane{}, outline_px));
  for (double t = 0.0; t < 1.45; t += 0.1) {
    const CameraView before = CameraAt(t);
    silhouette.Keep(FrameAt(t, {}),
                    before,
                    Outline(before, BodyAt(t)),
                    BodyAt(t).BottomCenterWorld(),
                    0.67);
  }
  camera.reset_count = 1;
  EXPECT_FALSE(
      silhouette.Measure(frame, camera, geometry::Plane{}, outline_px));
  camera.reset_count = 0;
  EXPECT_TRUE(silhouette.Measure(frame, camera, geometry::Plane{}, outline_px));
}

// Looks follow the ground before the car; nobody else is there.
TEST_F(MovingSilhouetteTest, OneBesideIsBelievedTheSecondTimeInARow) {
  TargetSilhouette silhouette;
  for (double t = 0.0; t < 1.45; t += 0.1) {
    const CameraView camera = CameraAt(t);
    silhouette.Keep(
        FrameAt(t, {}), camera, Outline(camera, BodyAt(t)), BodyAt(t));
  }
  const CameraView camera = CameraAt(1.5);
  const Box2 outline_px = Outline(camera, BodyAt(1.5));
  const Eigen::Vector2d off_px(0.6 * outline_px.width(), 0.0);
  auto body = *GroundTarget::Create(
      camera,
      {outline_px.min_px + off_px, outline_px.max_px + off_px},
      milliseconds(1'500),
      BoxCenter::kTexture,
      motion::MotionOptions());
  bool is_shared = false;
  const auto measure = [&](int time_ms) {
    const double time_s = 1e-3 * time_ms;
    body.Predict(milliseconds(time_ms));
    silhouette.Begin();
    silhouette.Measure(
        FrameAt(time_s, {}), CameraAt(time_s), body, [&](const Box2&) {
          return is_shared;
        });
    EXPECT_FALSE(silhouette.seen()) << time_ms;
    return silhouette.Beside().has_value();
  };
  EXPECT_TRUE(silhouette.IsDue(milliseconds(1'500)));
  EXPECT_FALSE(measure(1'500));
  EXPECT_FALSE(silhouette.IsDue(milliseconds(1'560)));
  // The same frame tells nothing new.
  EXPECT_FALSE(measure(1'500));
  EXPECT_TRUE(measure(1'600));
  is_shared = true;
  EXPECT_FALSE(measure(1'610));
  is_shared = false;
  EXPECT_TRUE(measure(1'620));
  silhouette.ForgetBeside();
  EXPECT_FALSE(measure(1'630));
}

}  // namespace
}  // namespace groundlock::tracking
