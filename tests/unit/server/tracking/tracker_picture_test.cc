// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/tracker_picture.h"

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/support/drawn_scene.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr double kDegree = std::numbers::pi / 180.0;
const Box2 kBox_px = Box2::FromXywh(270.0, 190.0, 60.0, 40.0);

class TrackerPictureTest : public ::testing::Test {
 protected:
  TrackerPictureTest() {
    image_ = test_support::Scene(test_support::Texture(560, 420, 3, 5.0),
                                 test_support::Texture(60, 40, 4, 2.0),
                                 kBox_px.x(),
                                 kBox_px.y());
    // Nothing is black but what is no image.
    image_ = cv::max(image_, 10);
    tracker_ = *target::CreateTargetTracker({.name = "dcf"});
    EXPECT_TRUE(tracker_->Initialize(image_, kBox_px).ok());
  }
  // Turned clockwise about the target's middle, seen later than before.
  image::Frame Turned(double angle_deg) {
    const Eigen::Vector2d center_px =
        kBox_px.center_px().array() - image::kPixelCenter;
    cv::Mat turned;
    cv::warpAffine(
        image_,
        turned,
        cv::getRotationMatrix2D(
            cv::Point2d(center_px.x(), center_px.y()), -angle_deg, 1.0),
        image_.size(),
        cv::INTER_CUBIC,
        cv::BORDER_REPLICATE);
    image::Frame frame = image::Frame::FromBgr(turned);
    frame.capture_time = std::chrono::milliseconds(++frames_);
    return frame;
  }
  // Looks about `box_px`, as TargetTrack does.
  target::TargetObservation Look(const image::Frame& frame,
                                 const Box2& box_px,
                                 const PatchTurn& turn) {
    picture_.Show(frame, *tracker_, box_px, turn);
    const Box2 there_px = picture_.ToTracker(box_px);
    tracker_->Place(there_px);
    target::TargetObservation seen = *tracker_->Detect(
        picture_.Within(frame, tracker_->DetectBox(there_px)), true);
    seen.box_px = picture_.FromTracker(seen.box_px);
    return seen;
  }

  cv::Mat image_;
  std::unique_ptr<target::TargetTracker> tracker_;
  TrackerPicture picture_;
  int frames_ = 0;
};

TEST_F(TrackerPictureTest, ATurnedTargetIsSeenAsIfItWereNot) {
  const image::Frame frame = Turned(40.0);
  const Box2 aside_px = Box2::FromCenter(
      kBox_px.center_px() + Eigen::Vector2d(7.0, -5.0), kBox_px.size_px());
  const auto turned = Look(frame, aside_px, {.angle_rad = 40.0 * kDegree});
  const auto not_turned = Look(frame, aside_px, {});
  EXPECT_GT(turned.confidence, 0.9);
  EXPECT_LT(not_turned.confidence, 0.7);
  EXPECT_LT((turned.box_px.center_px() - kBox_px.center_px()).norm(), 1.0);
  EXPECT_LT((turned.box_px.size_px() - kBox_px.size_px()).norm(), 1e-9);
}

TEST_F(TrackerPictureTest, ALargeOneIsDrawnCoarserAndSeenAsWell) {
  // So large that it is nearly halved.
  const Box2 large_px = Box2::FromXywh(320.0, 240.0, 108.0, 76.0);
  image_ = test_support::Scene(test_support::Texture(1'000, 700, 3, 9.0),
                               test_support::Texture(108, 76, 4, 4.0),
                               large_px.x(),
                               large_px.y());
  ASSERT_TRUE(tracker_->Initialize(image_, large_px).ok());
  ASSERT_EQ(tracker_->Halvings(large_px), 0);
  image::Frame frame = image::Frame::FromBgr(image_);
  const Box2 aside_px = Box2::FromCenter(
      large_px.center_px() + Eigen::Vector2d(9.0, -7.0), large_px.size_px());
  // Turned by so little that it is the target all the same.
  const auto seen = Look(frame, aside_px, {.angle_rad = 1e-6});
  EXPECT_LT(picture_.ToTracker(large_px).width(), 0.7 * large_px.width());
  EXPECT_GT(seen.confidence, 0.9);
  EXPECT_LT((seen.box_px.center_px() - large_px.center_px()).norm(), 1.0);
}

TEST_F(TrackerPictureTest, OfAnotherAngleItIsSeenLessWell) {
  const image::Frame frame = Turned(40.0);
  const double right =
      Look(frame, kBox_px, {.angle_rad = 40.0 * kDegree}).confidence;
  EXPECT_LT(Look(frame, kBox_px, {.angle_rad = -40.0 * kDegree}).confidence,
            right - 0.2);
}

TEST_F(TrackerPictureTest, WhatGoesInComesBack) {
  const image::Frame frame = Turned(0.0);
  for (const PatchTurn& turn :
       {PatchTurn{}, PatchTurn{0.7, Eigen::Vector2d(1.3, 0.8)}}) {
    picture_.Show(frame, *tracker_, kBox_px, turn);
    const Box2 box_px = Box2::FromXywh(251.0, 170.0, 44.0, 31.0);
    const Box2 back_px = picture_.FromTracker(picture_.ToTracker(box_px));
    EXPECT_LT((back_px.min_px - box_px.min_px).norm(), 1e-9);
    EXPECT_LT((back_px.max_px - box_px.max_px).norm(), 1e-9);
    EXPECT_LT((picture_.ToTracker(box_px).center_px() -
               picture_.ToTracker(Eigen::Vector2d(box_px.center_px())))
                  .norm(),
              1e-9);
    // A covariance turns with the picture.
    Eigen::Matrix2d covariance;
    covariance << 9.0, 1.0, 1.0, 2.0;
    const double scale = picture_.ToTracker(box_px).Area() / box_px.Area() /
                         turn.size_ratio.prod();
    EXPECT_NEAR(picture_.ToTracker(covariance).determinant(),
                scale * scale * covariance.determinant(),
                1e-9);
  }
}

TEST_F(TrackerPictureTest, UnturnedItIsTheFrameItself) {
  const image::Frame frame = Turned(0.0);
  picture_.Show(frame, *tracker_, kBox_px, {});
  const Box2 all_px = Box2::FromXywh(0.0, 0.0, image_.cols, image_.rows);
  EXPECT_EQ(cv::norm(picture_.Within(frame, all_px), image_, cv::NORM_INF),
            0.0);
}

TEST_F(TrackerPictureTest, OutsideTheImageItsEdgeIsRepeated) {
  const image::Frame frame = Turned(0.0);
  for (const Box2& box_px : {Box2::FromXywh(-30.0, -20.0, 60.0, 40.0),
                             Box2::FromXywh(540.0, 400.0, 60.0, 40.0),
                             Box2::FromXywh(-900.0, 5'000.0, 60.0, 40.0)}) {
    picture_.Show(frame, *tracker_, box_px, {.angle_rad = 0.6});
    const cv::Mat& picture =
        picture_.Within(frame, tracker_->DetectBox(picture_.ToTracker(box_px)));
    EXPECT_GE(picture.cols, 60);
    double least = 0.0;
    cv::minMaxLoc(picture.reshape(1), &least);
    EXPECT_GT(least, 0.0) << "black where there is no image";
  }
}

TEST_F(TrackerPictureTest, AHugeBoxIsNotTurned) {
  const image::Frame frame = Turned(0.0);
  const Box2 huge_px = Box2::FromXywh(-4e4, -4e4, 9e4, 9e4);
  picture_.Show(frame, *tracker_, huge_px, {.angle_rad = 0.6});
  EXPECT_LE(picture_.Within(frame, huge_px).cols, image_.cols);
}

TEST_F(TrackerPictureTest, TurnedItHoldsWhatIsAboutItsBox) {
  const image::Frame frame = Turned(0.0);
  const Box2 far_px = Box2::FromXywh(20.0, 20.0, 60.0, 40.0);
  picture_.Show(frame, *tracker_, kBox_px, {.angle_rad = 0.6});
  EXPECT_TRUE(picture_.Holds(frame, kBox_px));
  EXPECT_FALSE(picture_.Holds(frame, far_px));
  // Another frame has not been drawn.
  const image::Frame next = Turned(0.0);
  EXPECT_FALSE(picture_.Holds(next, kBox_px));
  // The frame itself holds everything.
  picture_.Show(frame, *tracker_, kBox_px, {});
  EXPECT_TRUE(picture_.Holds(frame, far_px));
  EXPECT_TRUE(picture_.Holds(next, kBox_px));
}

}  // namespace
}  // namespace groundlock::tracking
