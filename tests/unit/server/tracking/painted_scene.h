// SPDX-License-Identifier: Apache-2.0
// A painted car that drives over painted ground past a post, and a crate, seen
// from a camera that flies about them and is known.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_SCENE_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_SCENE_H_

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <random>
#include <utility>

#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/perturbation.h"
#include "tests/unit/server/tracking/views_of_ground.h"

namespace groundlock::tracking {

class PaintedScene {
 public:
  static constexpr int kWidth_px = 640;
  static constexpr int kHeight_px = 360;

  static geometry::CameraModel Camera() {
    return *geometry::CameraModel::Create(
        geometry::CameraModelId::kSimplePinhole,
        kWidth_px,
        kHeight_px,
        std::array{520.0, 0.5 * kWidth_px, 0.5 * kHeight_px});
  }
  static geometry::Rigid3 PoseAt(int frame) {
    const double azimuth_rad = 0.008 * frame - 0.4;
    const Eigen::Vector3d eye(
        5.0 * std::sin(azimuth_rad), -5.0 * std::cos(azimuth_rad), 2.4);
    geometry::Rigid3 pose = LookAt(eye, {0.1, 0.2, 0.2});
    // In the end it rolls.
    const double roll_rad = 0.01 * std::clamp(frame - 140, 0, 50);
    pose.rotation =
        pose.rotation * Eigen::AngleAxisd(roll_rad, Eigen::Vector3d::UnitZ());
    return pose;
  }
  // It stands for 45 frames, then drives, and turns to the left.
  static geometry::Box3 CarAt(int frame) {
    const int way = std::max(0, frame - 45);
    const double turned = std::max(0, way - 85);
    const double heading_rad = 0.02 * turned;
    const double x_m =
        -1.4 + 0.025 * std::min(way, 85) + 0.025 * std::sin(heading_rad) / 0.02;
    const double y_m = 0.025 * (1.0 - std::cos(heading_rad)) / 0.02;
    return ground::UprightBox(
        {},
        {x_m, y_m, 0.0},
        {std::cos(heading_rad), std::sin(heading_rad), 0.0},
        {0.9, 0.5, 0.4});
  }
  static geometry::Box3 Crate() {
    return ground::UprightBox(
        {}, {0.6, 1.5, 0.0}, {1.0, 0.3, 0.0}, {0.6, 0.5, 0.4});
  }
  static geometry::Box3 Post() {
    return ground::UprightBox(
        {}, {0.15, -0.9, 0.0}, Eigen::Vector3d::UnitX(), {0.55, 0.15, 1.3});
  }
  static geometry::Box2 CarBox(int frame) { return BoxOf(CarAt(frame), frame); }
  static geometry::Box2 CrateBox(int frame) { return BoxOf(Crate(), frame); }

  image::Frame FrameAt(int frame) {
    const geometry::CameraModel camera = Camera();
    const ground::GroundView view{&camera, PoseAt(frame), {}};
    cv::Mat bgr(kHeight_px, kWidth_px, CV_8UC3);
    const std::array<geometry::Box3, 3> boxes = {Post(), CarAt(frame), Crate()};
    std::array<geometry::Box2, 3> boxes_px;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      boxes_px[i] = *ground::ProjectBoxHull(view, boxes[i]);
    }
    std::normal_distribution<double> noise(0.0, 1.5);
    for (int y = 0; y < bgr.rows; ++y) {
      for (int x = 0; x < bgr.cols; ++x) {
        bgr.at<cv::Vec3b>(y, x) =
            ColourAt(view, {x + 0.5, y + 0.5}, boxes, boxes_px, noise);
      }
    }
    image::Frame made = image::Frame::FromBgr(test_support::Perturbed(bgr));
    made.sequence = static_cast<std::uint64_t>(frame);
    made.capture_time = std::chrono::milliseconds(40 * frame);
    return made;
  }

  static std::unique_ptr<TrackingSession> MakeSession(
      const SessionOptions& options) {
    return *TrackingSession::Create(std::make_unique<Flight>(),
                                    ground::MakePlaneSurface({}),
                                    Camera(),
                                    options);
  }

 private:
  class Flight : public localization::Localizer {
   public:
    absl::StatusOr<localization::LocalizationResult> Localize(
        const localization::LocalizationRequest& request) override {
      localization::LocalizationResult result;
      result.state = localization::CameraState::kTracked;
      result.world_from_camera =
          PoseAt(static_cast<int>(request.frame->sequence));
      return result;
    }
    void Reset() override {}
  };

  static geometry::Box2 BoxOf(const geometry::Box3& box, int frame) {
    const geometry::CameraModel camera = Camera();
    return *ground::ProjectBodyHull(
        {&camera, PoseAt(frame), {}}, box, {.plan = 1.0, .roof = 1.0});
  }
  // Squares as bright as chance has it, of a body's colour.
  static cv::Vec3d Paint(const Eigen::Vector3d& p,
                         double side_m,
                         std::uint32_t seed,
                         const cv::Vec3d& colour) {
    std::uint32_t mixed = seed;
    for (int k = 0; k < 3; ++k) {
      const auto cell =
          static_cast<std::int32_t>(std::floor(p[k] / side_m + 1e-6 * (k + 1)));
      mixed = (mixed ^ static_cast<std::uint32_t>(cell)) * 2654435761U;
      mixed ^= mixed >> 15;
    }
    return (0.3 + 0.7 * (mixed % 1024) / 1024.0) * colour;
  }
  cv::Vec3b ColourAt(const ground::GroundView& view,
                     const Eigen::Vector2d& pixel_px,
                     const std::array<geometry::Box3, 3>& boxes,
                     const std::array<geometry::Box2, 3>& boxes_px,
                     std::normal_distribution<double>& noise) {
    static const std::array<cv::Vec3d, 3> colours = {cv::Vec3d(90, 110, 90),
                                                     cv::Vec3d(60, 70, 230),
                                                     cv::Vec3d(220, 160, 60)};
    std::optional<cv::Vec3d> colour;
    double nearest_m = 1e9;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      if (!boxes_px[i].Contains(pixel_px)) continue;
      const Eigen::Vector3d p =
          ground::PointOnRay(view, boxes[i], pixel_px, 1.0);
      if (p.isZero()) continue;
      const double range_m =
          (boxes[i].world_from_object * p - view.world_from_camera.translation)
              .norm();
      if (range_m >= nearest_m) continue;
      nearest_m = range_m;
      colour = Paint(p, 0.06, static_cast<std::uint32_t>(i + 1), colours[i]);
    }
    if (!colour) {
      const auto p_world = ground::GroundFromImage(view, pixel_px);
      colour = p_world ? Paint(*p_world, 0.11, 9, {150, 160, 155})
                       : cv::Vec3d(200, 200, 200);
    }
    cv::Vec3b result;
    for (int c = 0; c < 3; ++c) {
      result[c] =
          cv::saturate_cast<std::uint8_t>((*colour)[c] + noise(random_));
    }
    return result;
  }

  std::mt19937_64 random_{5};
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_SCENE_H_
