// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/background_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "server/ground/ground_model.h"
#include "server/tracking/target_background.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

const Box2 kTarget = Box2::FromXywh(300, 220, 40, 30);

cv::Mat Texture(std::uint64_t seed) {
  cv::Mat bgr(480, 640, CV_8UC3);
  cv::RNG rng(seed);
  rng.fill(bgr, cv::RNG::UNIFORM, cv::Scalar::all(40), cv::Scalar::all(220));
  cv::GaussianBlur(bgr, bgr, {}, 2.0);
  return bgr;
}

// The image after a turn and growth about its middle, and a shift.
cv::Mat Moved(const cv::Mat& bgr,
              double turn_rad,
              double scale,
              const Eigen::Vector2d& shift_px) {
  cv::Mat warp = cv::getRotationMatrix2D(
      cv::Point2f(320.0F, 240.0F), -turn_rad * 180.0 / std::numbers::pi, scale);
  warp.at<double>(0, 2) += shift_px.x();
  warp.at<double>(1, 2) += shift_px.y();
  cv::Mat moved;
  cv::warpAffine(
      bgr, moved, warp, bgr.size(), cv::INTER_LINEAR, cv::BORDER_REFLECT);
  return moved;
}

TEST(BackgroundMotion, IsWhatSurroundsTheTargetDoes) {
  BackgroundMotion background;
  const cv::Mat first = Texture(3);
  EXPECT_FALSE(background.Follow(image::Frame::FromBgr(first), kTarget));
  const Eigen::Vector2d shift_px(14.0, -9.0);
  cv::Mat second = Moved(first, 0.02, 1.01, shift_px);
  // The target itself goes the other way.
  Texture(5)(cv::Rect(0, 0, 40, 30)).copyTo(second(cv::Rect(280, 220, 40, 30)));
  const auto found = background.Follow(image::Frame::FromBgr(second), kTarget);
  ASSERT_TRUE(found.has_value());
  // The warp counts from the first pixel's centre, as it turns about (320,
  // 240).
  const Eigen::Vector2d middle(320.5, 240.5);
  EXPECT_LT((*found * middle - middle - shift_px).norm(), 0.1);
  EXPECT_NEAR(found->turn(0, 0), 1.01 * std::cos(0.02), 2e-3);
  EXPECT_NEAR(found->turn(1, 0), 1.01 * std::sin(0.02), 2e-3);
}

TEST(BackgroundMotion, IsUnknownWithoutAFrameBeforeOrCorners) {
  BackgroundMotion background;
  const image::Frame frame = image::Frame::FromBgr(Texture(3));
  EXPECT_FALSE(background.Follow(frame, kTarget));
  EXPECT_TRUE(background.Follow(frame, kTarget));
  // Of another size.
  cv::Mat small;
  cv::resize(Texture(3), small, cv::Size(320, 240));
  EXPECT_FALSE(background.Follow(image::Frame::FromBgr(small), kTarget));
  // Nothing to be seen around it.
  const image::Frame flat =
      image::Frame::FromBgr(cv::Mat(240, 320, CV_8UC3, cv::Scalar::all(90)));
  EXPECT_FALSE(background.Follow(flat, kTarget));
  EXPECT_FALSE(background.Follow(flat, kTarget));
  // Boxes that are nowhere, or everywhere.
  for (const Box2& box : {Box2::FromXywh(-900, -900, 10, 10),
                          Box2::FromXywh(-1e6, -1e6, 2e6, 2e6),
                          Box2::FromXywh(NAN, 0, 10, 10)}) {
    EXPECT_FALSE(background.Follow(flat, box));
  }
}

geometry::CameraModel TestCamera() {
  return *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                        640,
                                        480,
                                        std::array{600.0, 320.0, 240.0});
}

// 5 m over the ground, it looks ahead and down.
geometry::Rigid3 PoseAt(double x_m, double turn_rad) {
  geometry::Rigid3 world_from_camera;
  world_from_camera.rotation =
      Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()) *
      Eigen::AngleAxisd(-0.5 * std::numbers::pi - 0.5,
                        Eigen::Vector3d::UnitX());
  world_from_camera.translation = {x_m, 0.0, 5.0};
  return world_from_camera;
}

TEST(MotionOfPlane, IsThatOfTheGroundAboutTheTarget) {
  const geometry::CameraModel camera = TestCamera();
  const geometry::Plane ground{Eigen::Vector3d::UnitZ(), 0.0};
  const auto moved = MotionOfPlane(
      camera, PoseAt(0.0, 0.0), PoseAt(0.2, 0.01), ground, kTarget);
  ASSERT_TRUE(moved);
  const ground::GroundView before{&camera, PoseAt(0.0, 0.0), ground};
  for (const Eigen::Vector2d& off_px : {Eigen::Vector2d(0, 0),
                                        Eigen::Vector2d(30, 10),
                                        Eigen::Vector2d(-20, 25)}) {
    const Eigen::Vector2d from_px = kTarget.center_px() + off_px;
    const auto ray = ground::RayWorld(before, from_px);
    ASSERT_TRUE(ray);
    const auto p_world =
        IntersectRay(ground, before.world_from_camera.translation, *ray);
    ASSERT_TRUE(p_world);
    const auto to_px =
        camera.ImageFromCamera(PoseAt(0.2, 0.01).Inverse() * *p_world);
    ASSERT_TRUE(to_px);
    EXPECT_LT((*moved * from_px - *to_px).norm(), 0.1) << off_px.transpose();
    EXPECT_GT((*to_px - from_px).norm(), 5.0);
  }
  // Over the horizon there is no ground.
  EXPECT_FALSE(MotionOfPlane(camera,
                             PoseAt(0.0, 0.0),
                             PoseAt(0.2, 0.01),
                             ground,
                             Box2::FromXywh(300, -200, 40, 30)));
}

// Where poses are known and go on they tell it, else the image does, in which
// here nothing moves.
TEST(TargetBackground, GoesAsPosesHaveItElseAsTheImageDoes) {
  const geometry::CameraModel lens = TestCamera();
  const geometry::Plane ground{Eigen::Vector3d::UnitZ(), 0.0};
  const image::Frame frame = image::Frame::FromBgr(Texture(3));
  CameraView before;
  before.view = {&lens, PoseAt(0.0, 0.0), ground};
  CameraView after = before;
  after.view.world_from_camera = PoseAt(0.2, 0.01);
  const Eigen::Vector2d middle_px = kTarget.center_px();

  TargetBackground background;
  background.Start(frame, &before);
  EXPECT_FALSE(background.motion());
  background.Follow(frame, &after, &ground, kTarget);
  ASSERT_TRUE(background.motion());
  EXPECT_TRUE(background.is_known());
  EXPECT_GT((*background.motion() * middle_px - middle_px).norm(), 5.0);

  const auto by_image = [&](const char* what) {
    EXPECT_FALSE(background.is_known()) << what;
    ASSERT_TRUE(background.motion()) << what;
    EXPECT_LT((*background.motion() * middle_px - middle_px).norm(), 0.1)
        << what;
  };
  CameraView another_world = before;
  another_world.reset_count = 1;
  background.Follow(frame, &another_world, &ground, kTarget);
  by_image("of another world");
  background.Follow(frame, nullptr, &ground, kTarget);
  by_image("no pose");
  background.Follow(frame, &after, &ground, kTarget);
  by_image("no pose before");
  background.Follow(frame, &before, nullptr, kTarget);
  by_image("no ground");
  CameraView held = after;
  held.verified = false;
  background.Follow(frame, &held, &ground, kTarget);
  by_image("a held pose");

  background.Skip(&before);
  EXPECT_FALSE(background.motion());
  background.Follow(frame, &after, &ground, kTarget);
  EXPECT_TRUE(background.is_known());
}

}  // namespace
}  // namespace groundlock::tracking
