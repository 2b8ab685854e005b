// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/image_motion.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "server/tracking/tracking_session.h"
#include "tests/support/perturbation.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;

TEST(ImageMotion, IsAsSureAsItHasPredicted) {
  ImageMotion steady;
  ImageMotion shaken;
  const auto box = [](double x) { return Box2::FromXywh(x, 100, 40, 40); };
  steady.Restart(box(0), milliseconds(0));
  shaken.Restart(box(0), milliseconds(0));
  for (int i = 1; i <= 60; ++i) {
    steady.Update(box(5.0 * i), milliseconds(40 * i));
    shaken.Update(box(5.0 * i + (i % 2 == 0 ? 20 : -20)), milliseconds(40 * i));
  }
  const auto next = steady.Predict(milliseconds(40 * 61));
  EXPECT_NEAR(next.center_px.x(), 20.0 + 305.0, 0.5);
  EXPECT_LT(std::sqrt(next.covariance_px2(0, 0)), 2.0);
  const auto unsure = shaken.Predict(milliseconds(40 * 61));
  EXPECT_GT(std::sqrt(unsure.covariance_px2(0, 0)), 15.0);
  // Unseen it gets lost, but not without end.
  const auto later = steady.Predict(milliseconds(40 * 160));
  EXPECT_GT(later.covariance_px2(0, 0), 25.0 * next.covariance_px2(0, 0));
  EXPECT_LE(steady.Predict(std::chrono::hours(1)).covariance_px2(0, 0),
            160.0 * 160.0 + 1e-6);
}

TEST(ImageMotion, AgainstTheBackgroundItIsSteadyThoughTheCameraShakes) {
  ImageMotion motion;
  const auto box = [](double x) { return Box2::FromXywh(x, 100, 40, 40); };
  double camera_px = 0.0;
  motion.Restart(box(0.0), milliseconds(0));
  for (int i = 1; i <= 20; ++i) {
    ImageAffinity shift;
    shift.shift_px.x() = i % 2 == 0 ? 30.0 : -30.0;
    camera_px += shift.shift_px.x();
    motion.Carry(shift);
    if (i == 20) break;
    motion.Update(box(2.0 * i + camera_px), milliseconds(40 * i));
  }
  const auto next = motion.Predict(milliseconds(40 * 20));
  EXPECT_NEAR(next.center_px.x(), 20.0 + 40.0 + camera_px, 0.5);
  EXPECT_LT(std::sqrt(next.covariance_px2(0, 0)), 4.0);
  EXPECT_TRUE(motion.IsBetterThanRest());
  ASSERT_TRUE(motion.LeftBehind_px().has_value());
  EXPECT_NEAR(motion.LeftBehind_px()->x(), 20.0 + 38.0 + camera_px, 1e-9);
  // Where the background is not known, the image is all there is.
  motion.Carry(std::nullopt);
  EXPECT_FALSE(motion.LeftBehind_px().has_value());
  EXPECT_FALSE(motion.IsBetterThanRest());
  EXPECT_GT(
      std::sqrt(motion.Predict(milliseconds(40 * 20)).covariance_px2(0, 0)),
      10.0);
}

image::Frame ToFrame(int index, const cv::Mat& bgr) {
  image::Frame frame = image::Frame::FromBgr(bgr);
  frame.sequence = static_cast<std::uint64_t>(index);
  frame.capture_time = milliseconds(100 * index);
  return frame;
}

std::unique_ptr<TrackingSession> OpenSession(const cv::Size& size) {
  const std::array<double, 3> lens = {
      1000.0, 0.5 * size.width, 0.5 * size.height};
  SessionOptions options;
  options.tracker.name = "dcf";
  return *TrackingSession::Create(
      nullptr,
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     size.width,
                                     size.height,
                                     lens),
      options);
}

// Coarse and fine, as what is seen from above is.
cv::Mat Landscape(const cv::Size& size, cv::RNG& rng) {
  cv::Mat landscape(size, CV_8UC3, cv::Scalar::all(0));
  for (const int grain_px : {2, 8, 32, 128}) {
    cv::Mat noise(size / grain_px + cv::Size(2, 2), CV_8UC3);
    rng.fill(noise, cv::RNG::UNIFORM, cv::Scalar::all(10), cv::Scalar::all(60));
    cv::Mat grown;
    cv::resize(noise, grown, {}, grain_px, grain_px, cv::INTER_CUBIC);
    landscape += grown(cv::Rect(cv::Point(), size));
  }
  return landscape;
}

// Looks stay with a kerb, from which motion puts the target ahead: what looks
// find at the kerb after that has stayed, for all that the target has moved.
TEST(ImageMotion, HowFastLooksGoLooksAloneTell) {
  ImageMotion motion;
  const auto box = [](double x) { return Box2::FromXywh(x, 100, 20, 20); };
  motion.Restart(box(0.0), milliseconds(0));
  ImageAffinity pan;
  pan.shift_px.x() = 3.0;
  double background_px = 0.0;
  const auto carry = [&] {
    motion.Carry(pan);
    background_px += 3.0;
  };
  int frame = 1;
  for (; frame <= 10; ++frame) {
    carry();
    motion.Update(box(background_px), milliseconds(100 * frame));
  }
  for (; frame <= 14; ++frame) {
    carry();
    motion.Update(box(background_px + 4.0 * (frame - 10)),
                  milliseconds(100 * frame),
                  1.0,
                  /*by_looks=*/false);
  }
  EXPECT_GT(motion.OverBackground_px_s().x(), 10.0);
  EXPECT_NEAR(motion.LooksOverBackground().px_s.x(), 0.0, 1.0);
  carry();
  const auto looks_px_s = [&](double x) {
    return motion
        .LooksOverBackground(box(x).center_px(), milliseconds(100 * frame))
        .px_s.x();
  };
  EXPECT_NEAR(looks_px_s(background_px), 0.0, 1.0);
  // 20 px in the 0.5 s since the last look.
  EXPECT_GT(looks_px_s(background_px + 20.0), 15.0);
}

// A gust turns the camera by three sides of a small target from one frame to
// the next: farther than the tracker looks.
TEST(ImageMotion, ASmallTargetIsFollowedThroughJerksOfTheCamera) {
  cv::RNG rng(11);
  const cv::Mat background = Landscape({1000, 480}, rng);
  cv::Mat target(16, 28, CV_8UC3);
  rng.fill(target,
           cv::RNG::UNIFORM,
           cv::Scalar(0, 60, 120),
           cv::Scalar(60, 160, 255));
  cv::GaussianBlur(target, target, {}, 1.0);
  const auto session = OpenSession({640, 480});
  for (int i = 0; i < 60; ++i) {
    const int camera_px = 150 + (i / 12 % 2 == 0 ? 0 : 60);
    const Box2 truth = Box2::FromXywh(400 + i - camera_px, 232, 28, 16);
    cv::Mat world = background.clone();
    target.copyTo(world(cv::Rect(400 + i, 232, 28, 16)));
    if (i == 0) {
      ASSERT_TRUE(session->SetTarget("car", truth, {}).ok());
    }
    const cv::Mat seen = world(cv::Rect(camera_px, 0, 640, 480)).clone();
    const auto result = session->ProcessFrame(
        ToFrame(i, test_support::Perturbed(seen)), std::nullopt, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets[0].state, TargetState::kTracked) << i;
    EXPECT_LT(
        (result->targets[0].box_px->center_px() - truth.center_px()).norm(),
        3.0)
        << i;
  }
}

}  // namespace
}  // namespace groundlock::tracking
