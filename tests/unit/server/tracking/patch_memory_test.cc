// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/patch_memory.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>

#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;
using geometry::Box3;

// A painted box of 0.9 x 0.5 x 0.4 m on gray ground z = 0, seen from 4 m.
class PatchMemoryTest : public testing::Test {
 protected:
  // From an azimuth about the origin.
  CameraView CameraFrom(double azimuth_deg, double distance_m = 4.0) const {
    const double a = azimuth_deg * std::numbers::pi / 180.0;
    const Vector3d eye(
        distance_m * std::sin(a), -distance_m * std::cos(a), 0.4 * distance_m);
    const Vector3d forward = (Vector3d(0.0, 0.0, 0.2) - eye).normalized();
    const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    CameraView camera;
    camera.view = {&camera_, {Eigen::Quaterniond(R), eye}, geometry::Plane{}};
    return camera;
  }
  static Box3 BodyAt(double x_m, double y_m = 0.0) {
    return ground::UprightBox(
        geometry::Plane{}, {x_m, y_m, 0.0}, Vector3d::UnitX(), {0.9, 0.5, 0.4});
  }
  static Box2 Outline(const CameraView& camera, const Box3& body) {
    return *ground::ProjectBodyHull(
        camera.view, body, {.plan = 1.0, .roof = 1.0, .clearance = 0.0});
  }

  // Each face has squares of 5 cm, as bright as chance has it.
  static double Paint(const Vector3d& p_body, std::uint32_t seed) {
    std::uint32_t mixed = seed;
    for (int k = 0; k < 3; ++k) {
      const auto cell = static_cast<std::int32_t>(
          std::floor(p_body[k] / 0.05 + 1e-6 * (k + 1)));
      mixed = (mixed ^ static_cast<std::uint32_t>(cell)) * 2654435761U;
      mixed ^= mixed >> 15;
    }
    return 40.0 + mixed % 1024 / 1024.0 * 180.0;
  }

  // `body` null: the ground alone.
  image::Frame FrameOf(const CameraView& camera,
                       const Box3* body,
                       std::uint32_t paint = 1) {
    cv::Mat bgr(360, 640, CV_8UC3);
    std::normal_distribution<double> noise(0.0, 2.0);
    for (int y = 0; y < bgr.rows; ++y) {
      for (int x = 0; x < bgr.cols; ++x) {
        double level = 120.0;
        const Vector2d pixel_px(x + 0.5, y + 0.5);
        if (body != nullptr) {
          const Vector3d p_body =
              ground::PointOnRay(camera.view, *body, pixel_px, 1.0);
          if (!p_body.isZero()) level = Paint(p_body, paint);
        }
        bgr.at<cv::Vec3b>(y, x) = cv::Vec3b::all(
            cv::saturate_cast<std::uint8_t>(level + noise(random_)));
      }
    }
    image::Frame frame = image::Frame::FromBgr(bgr);
    frame.capture_time = std::chrono::milliseconds(40 * ++frames_);
    return frame;
  }

  // The body was seen at the origin from the front.
  void Keep() {
    const CameraView camera = CameraFrom(0.0);
    const Box3 body = BodyAt(0.0);
    memory_.Keep(FrameOf(camera, &body), camera, body, Outline(camera, body));
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

  geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     640,
                                     360,
                                     std::array{525.0, 320.0, 180.0});
  std::mt19937_64 random_{5};
  int frames_ = 0;
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
