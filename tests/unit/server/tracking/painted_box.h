// SPDX-License-Identifier: Apache-2.0
// A painted box on gray ground, drawn as a camera sees it.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_BOX_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_BOX_H_

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "server/image/frame.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// A painted box of 0.9 x 0.5 x 0.4 m on gray ground z = 0, seen from 4 m.
class PaintedBoxTest : public testing::Test {
 protected:
  // From an azimuth about the origin.
  CameraView CameraFrom(double azimuth_deg, double distance_m = 4.0) const {
    const double a = azimuth_deg * std::numbers::pi / 180.0;
    const Eigen::Vector3d eye(
        distance_m * std::sin(a), -distance_m * std::cos(a), 0.4 * distance_m);
    const Eigen::Vector3d forward =
        (Eigen::Vector3d(0.0, 0.0, 0.2) - eye).normalized();
    const Eigen::Vector3d right =
        forward.cross(Eigen::Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    CameraView camera;
    camera.view = {&camera_, {Eigen::Quaterniond(R), eye}, geometry::Plane{}};
    return camera;
  }
  static geometry::Box3 BodyAt(double x_m, double y_m = 0.0) {
    return ground::UprightBox(geometry::Plane{},
                              {x_m, y_m, 0.0},
                              Eigen::Vector3d::UnitX(),
                              {0.9, 0.5, 0.4});
  }
  static geometry::Box2 Outline(const CameraView& camera,
                                const geometry::Box3& body) {
    return *ground::ProjectBodyHull(
        camera.view, body, {.plan = 1.0, .roof = 1.0, .clearance = 0.0});
  }

  // Each face has squares of 5 cm, as bright as chance has it.
  static double Paint(const Eigen::Vector3d& p_body, std::uint32_t seed) {
    std::uint32_t mixed = seed;
    for (int k = 0; k < 3; ++k) {
      const auto cell = static_cast<std::int32_t>(
          std::floor(p_body[k] / 0.05 + 1e-6 * (k + 1)));
      mixed = (mixed ^ static_cast<std::uint32_t>(cell)) * 2654435761U;
      mixed ^= mixed >> 15;
    }
    return 40.0 + mixed % 1024 / 1024.0 * 180.0;
  }

  // `body` null: the ground alone. `post_px`: columns that a post hides.
  image::Frame FrameOf(const CameraView& camera,
                       const geometry::Box3* body,
                       std::uint32_t paint = 1,
                       std::array<int, 2> post_px = {0, 0}) {
    cv::Mat bgr(360, 640, CV_8UC3);
    std::normal_distribution<double> noise(0.0, 2.0);
    for (int y = 0; y < bgr.rows; ++y) {
      for (int x = 0; x < bgr.cols; ++x) {
        double level = 120.0;
        const Eigen::Vector2d pixel_px(x + 0.5, y + 0.5);
        if (body != nullptr) {
          const Eigen::Vector3d p_body =
              ground::PointOnRay(camera.view, *body, pixel_px, 1.0);
          if (!p_body.isZero()) level = Paint(p_body, paint);
        }
        // It has a texture, too, or nothing would stick to it.
        if (x >= post_px[0] && x < post_px[1]) {
          level = y / 6 % 2 == 0 ? 40.0 : 90.0;
        }
        bgr.at<cv::Vec3b>(y, x) = cv::Vec3b::all(
            cv::saturate_cast<std::uint8_t>(level + noise(random_)));
      }
    }
    image::Frame frame = image::Frame::FromBgr(bgr);
    frame.capture_time = std::chrono::milliseconds(40 * ++frames_);
    return frame;
  }

  geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     640,
                                     360,
                                     std::array{525.0, 320.0, 180.0});
  std::mt19937_64 random_{5};
  int frames_ = 0;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_TRACKING_PAINTED_BOX_H_
