// SPDX-License-Identifier: Apache-2.0
// A made-up scene for tests of pose estimation: points in front of a camera
// with lens distortion, their pixels, noise and outliers on demand.
#ifndef GROUNDLOCK_TESTS_SUPPORT_SYNTHETIC_SCENE_H_
#define GROUNDLOCK_TESTS_SUPPORT_SYNTHETIC_SCENE_H_

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::test_support {

// SIMPLE_RADIAL, 1280x720, f = 1050 px, k = -0.045.
geometry::CameraModel MakeCamera();

// At (1, -2, 1.6) m, tilted down a little: nothing is axis-aligned.
geometry::Rigid3 MakeWorldFromCamera();

struct SceneOptions {
  int num_points = 200;
  double min_depth_m = 3.0;
  double max_depth_m = 12.0;
  double noise_px = 0.0;       // standard deviation per coordinate
  double outlier_ratio = 0.0;  // pixels drawn anew over the whole image
  std::uint64_t seed = 1;
};

// Pixels are spread over the image, depths over the range.
struct Scene {
  geometry::CameraModel camera;
  geometry::Rigid3 world_from_camera;
  std::vector<Eigen::Vector3d> p_world;
  std::vector<Eigen::Vector2d> pixel_px;
  std::vector<bool> is_outlier;
};

Scene MakeScene(const SceneOptions& options);

// Distance of the centres and angle between the orientations.
double CenterError(const geometry::Rigid3& a, const geometry::Rigid3& b);
double AngleError_rad(const geometry::Rigid3& a, const geometry::Rigid3& b);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_SYNTHETIC_SCENE_H_
