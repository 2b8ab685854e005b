// SPDX-License-Identifier: Apache-2.0
// Sessions with the real 2D tracker on a small drawn scene and a camera that is
// known.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_DRAWN_SESSION_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_DRAWN_SESSION_H_

#include <Eigen/Geometry>
#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/ground/box_fit.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/perturbation.h"

namespace groundlock::tracking {

// Looks along +y from 2 m over the ground, a little down.
class KnownCamera : public localization::Localizer {
 public:
  static geometry::Rigid3 Pose() {
    Eigen::Matrix3d level;
    level << Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitZ(),
        Eigen::Vector3d::UnitY();
    return {Eigen::Quaterniond(level) *
                Eigen::AngleAxisd(-0.3, Eigen::Vector3d::UnitX()),
            {0.0, 0.0, 2.0}};
  }
  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest& request) override {
    const auto frame = static_cast<int>(request.frame->sequence);
    localization::LocalizationResult result;
    result.state = localization::CameraState::kTracked;
    if (frame >= held_from && frame < lost_from) {
      result.state = localization::CameraState::kHeld;
    } else if (frame >= lost_from && frame < back_from) {
      result.state = localization::CameraState::kLost;
      return result;
    } else if (frame >= odometry_from) {
      result.state = localization::CameraState::kOdometry;
    }
    result.world_from_camera = Pose();
    return result;
  }
  // Frames without a verified pose, then without any.
  int held_from = 1'000'000;
  int lost_from = 1'000'000;
  int back_from = 1'000'000;
  int odometry_from = 1'000'000;
  void Reset() override {}
};

inline geometry::CameraModel TestCamera() {
  const std::array<double, 3> params = {500.0, 320.0, 240.0};
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 640, 480, params);
}

inline geometry::Box2 TargetBox(double x_m, double y_m = 6.0) {
  const geometry::CameraModel camera = TestCamera();
  const ground::GroundView view{&camera, KnownCamera::Pose(), {}};
  return *ground::ProjectBodyHull(
      view,
      ground::UprightBox(
          {}, {x_m, y_m, 0.0}, Eigen::Vector3d::UnitX(), {1.0, 0.6, 0.6}));
}

inline cv::Mat Background() {
  cv::Mat bgr(480, 640, CV_8UC3);
  cv::RNG rng(7);
  rng.fill(bgr, cv::RNG::UNIFORM, cv::Scalar::all(90), cv::Scalar::all(150));
  cv::GaussianBlur(bgr, bgr, {}, 1.5);
  return bgr;
}

// A red and blue target.
inline void DrawTarget(cv::Mat& bgr, const geometry::Box2& target_px) {
  const cv::Rect2d box(
      target_px.x(), target_px.y(), target_px.width(), target_px.height());
  cv::rectangle(bgr, box, {30, 30, 220}, cv::FILLED);
  cv::rectangle(
      bgr,
      cv::Rect2d(
          box.x + 0.3 * box.width, box.y, 0.3 * box.width, 0.6 * box.height),
      {230, 60, 20},
      cv::FILLED);
}

inline image::Frame ToFrame(std::uint64_t sequence, const cv::Mat& bgr) {
  image::Frame frame = image::Frame::FromBgr(test_support::Perturbed(bgr));
  frame.sequence = sequence;
  frame.capture_time = std::chrono::milliseconds(40 * sequence);
  return frame;
}

// Gray noise, and the target before it unless it is hidden.
inline image::Frame Draw(std::uint64_t sequence,
                         const geometry::Box2& target_px,
                         bool hidden) {
  cv::Mat bgr = Background();
  if (!hidden) DrawTarget(bgr, target_px);
  return ToFrame(sequence, bgr);
}

inline std::unique_ptr<TrackingSession> MakeSession(
    bool with_camera, SessionOptions options = {}) {
  std::unique_ptr<localization::Localizer> localizer;
  if (with_camera) localizer = std::make_unique<KnownCamera>();
  return *TrackingSession::Create(std::move(localizer),
                                  ground::MakePlaneSurface({}),
                                  TestCamera(),
                                  options);
}

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_DRAWN_SESSION_H_
