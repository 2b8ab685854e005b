// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/earlier_frames.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <opencv2/core/mat.hpp>

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;
using std::chrono::milliseconds;

class EarlierFramesTest : public testing::Test {
 protected:
  explicit EarlierFramesTest(int times = 1)
      : camera_(*geometry::CameraModel::Create(
            geometry::CameraModelId::kSimplePinhole,
            640 * times,
            480 * times,
            std::array{500.0 * times, 320.0 * times, 240.0 * times})) {}

  // Looks along z.
  CameraView ViewFrom(const Vector3d& eye) const {
    CameraView view;
    view.view.camera = &camera_;
    view.view.world_from_camera = {Eigen::Quaterniond::Identity(), eye};
    return view;
  }
  image::Frame FrameAt(milliseconds time) const {
    image::Frame frame = image::Frame::FromBgr(
        cv::Mat::zeros(camera_.height_px(), camera_.width_px(), CV_8UC3));
    frame.capture_time = time;
    return frame;
  }
  Box2 SeenFrom(const Vector3d& eye, const Vector3d& p, double side_m) const {
    const double focal_px = 500.0 * camera_.width_px() / 640.0;
    const Vector3d there = p - eye;
    return Box2::FromCenter(
        Eigen::Vector2d(0.5 * camera_.width_px(), 0.5 * camera_.height_px()) +
            focal_px * there.head<2>() / there.z(),
        Eigen::Vector2d::Constant(focal_px * side_m / there.z()));
  }

  geometry::CameraModel camera_;
  EarlierFrames frames_;
  const Box2 target_px_ = Box2::FromXywh(20.0, 20.0, 30.0, 30.0);
};

TEST_F(EarlierFramesTest, SaysWhereWhatStandsBeforeTheGroundWas) {
  frames_.Keep(FrameAt(milliseconds(0)), ViewFrom({0.0, 0.0, 0.0}), target_px_);
  const Vector3d eye(0.8, 0.2, 1.0);
  // Something 9 m away, where the ground is seen 16 m away.
  const Vector3d p(0.5, 0.3, 10.0);
  const auto places =
      frames_.PlacesOf(ViewFrom(eye), SeenFrom(eye, p, 0.6), 16.0);
  const Box2 truth_px = SeenFrom(Vector3d::Zero(), p, 0.6);
  EXPECT_TRUE(std::any_of(places.begin(), places.end(), [&](const auto& place) {
    return geometry::IntersectionOverUnion(place.box_px, truth_px) > 0.8;
  }));
  EXPECT_EQ(places.size(), 4U);
}

TEST_F(EarlierFramesTest, NotWhereTheTargetWasNorOutOfView) {
  frames_.Keep(FrameAt(milliseconds(0)), ViewFrom({0.0, 0.0, 0.0}), target_px_);
  const CameraView view = ViewFrom({0.0, 0.0, 0.0});
  EXPECT_TRUE(
      frames_.PlacesOf(view, Box2::FromXywh(40.0, 30.0, 30.0, 30.0), 10.0)
          .empty());
  EXPECT_TRUE(
      frames_.PlacesOf(view, Box2::FromXywh(630.0, 300.0, 30.0, 30.0), 10.0)
          .empty());
  EXPECT_FALSE(
      frames_.PlacesOf(view, Box2::FromXywh(300.0, 300.0, 30.0, 30.0), 10.0)
          .empty());
}

TEST_F(EarlierFramesTest, KeepsAFewApartAndNoneFromBeforeAReset) {
  const Box2 there_px = Box2::FromXywh(300.0, 300.0, 30.0, 30.0);
  CameraView view = ViewFrom({0.0, 0.0, 0.0});
  for (int i = 0; i < 100; ++i) {
    frames_.Keep(FrameAt(milliseconds(100 * i)), view, target_px_);
  }
  EXPECT_EQ(frames_.PlacesOf(view, there_px, 10.0).size(), 3U * 4U);
  ++view.reset_count;
  EXPECT_TRUE(frames_.PlacesOf(view, there_px, 10.0).empty());
  frames_.Keep(FrameAt(milliseconds(10'000)), view, target_px_);
  EXPECT_EQ(frames_.PlacesOf(view, there_px, 10.0).size(), 4U);
}

class LargeEarlierFramesTest : public EarlierFramesTest {
 protected:
  LargeEarlierFramesTest() : EarlierFramesTest(6) {}
};

TEST_F(LargeEarlierFramesTest, AreKeptSmall) {
  const CameraView view = ViewFrom({0.0, 0.0, 0.0});
  frames_.Keep(FrameAt(milliseconds(0)), view, target_px_);
  const auto places = frames_.PlacesOf(
      view, Box2::FromXywh(1'600.0, 1'600.0, 400.0, 400.0), 10.0);
  ASSERT_FALSE(places.empty());
  EXPECT_LE(places[0].frame->size_px().area(), 1 << 19);
  EXPECT_NEAR(places[0].box_px.x(), 1'600.0 / 8.0, 1e-6);
  EXPECT_NEAR(places[0].box_px.width(), 400.0 / 8.0, 1e-6);
}

}  // namespace
}  // namespace groundlock::tracking
