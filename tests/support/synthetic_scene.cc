// SPDX-License-Identifier: Apache-2.0
#include "tests/support/synthetic_scene.h"

#include <array>
#include <cstddef>
#include <random>

#include "tests/support/perturbation.h"

namespace groundlock::test_support {

geometry::CameraModel MakeCamera() {
  constexpr std::array<double, 4> kParams = {1050.0, 640.0, 360.0, -0.045};
  return geometry::CameraModel::Create(
             geometry::CameraModelId::kSimpleRadial, 1280, 720, kParams)
      .value();
}

geometry::Rigid3 MakeWorldFromCamera() {
  // Looking along +y: camera z = world y, camera y = world -z, then turned.
  const Eigen::Quaterniond level(
      Eigen::AngleAxisd(-M_PI / 2.0, Eigen::Vector3d::UnitX()));
  const Eigen::Quaterniond turn =
      geometry::QuaternionFromRotationVector(Eigen::Vector3d(-0.15, 0.07, 0.4));
  return {(turn * level).normalized(), Eigen::Vector3d(1.0, -2.0, 1.6)};
}

Scene MakeScene(const SceneOptions& options) {
  std::mt19937_64 engine(PerturbedSeed(options.seed));
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  Scene scene{.camera = MakeCamera(),
              .world_from_camera = MakeWorldFromCamera(),
              .p_world = {},
              .pixel_px = {},
              .is_outlier = {}};
  const auto draw_pixel = [&] {
    const double x = unit(engine) * scene.camera.width_px();
    const double y = unit(engine) * scene.camera.height_px();
    return Eigen::Vector2d(x, y);
  };
  for (int i = 0; i < options.num_points; ++i) {
    const Eigen::Vector2d pixel_px = draw_pixel();
    const Eigen::Vector2d xy = *scene.camera.NormalizedFromImage(pixel_px);
    const double depth_m =
        options.min_depth_m +
        unit(engine) * (options.max_depth_m - options.min_depth_m);
    scene.p_world.push_back(scene.world_from_camera *
                            Eigen::Vector3d(depth_m * xy.homogeneous()));
    const double dx_px = options.noise_px * noise(engine);
    const double dy_px = options.noise_px * noise(engine);
    const bool is_outlier = unit(engine) < options.outlier_ratio;
    scene.pixel_px.push_back(
        is_outlier ? draw_pixel() : pixel_px + Eigen::Vector2d(dx_px, dy_px));
    scene.is_outlier.push_back(is_outlier);
  }
  return scene;
}

double CenterError(const geometry::Rigid3& a, const geometry::Rigid3& b) {
  return (a.translation - b.translation).norm();
}

double AngleError_rad(const geometry::Rigid3& a, const geometry::Rigid3& b) {
  return geometry::AngleBetween_rad(a.rotation, b.rotation);
}

}  // namespace groundlock::test_support
