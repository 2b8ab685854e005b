// SPDX-License-Identifier: Apache-2.0
// What stands in a scene: textured surfaces and the quads that they cover.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SCENE_MODEL_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SCENE_MODEL_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <opencv2/core.hpp>
#include <vector>

#include "client/simulator/internal/terrain.h"

namespace groundlock::simulator {

struct SurfacePoint {
  Eigen::Vector3f p_world;
  Eigen::Vector3f normal_world;
};

// One painted surface: a rectangle, the ground, or the side or lid of a
// cylinder.
struct Surface {
  cv::Mat albedo;  // CV_8UC3
  float texels_per_m = 1.0F;
  bool wrap_u = false;
  cv::Size light_grid;  // resolution at which light is computed
  // Where the texture's point (u, v) lies, u to the right, v down, in [0, 1].
  std::function<SurfacePoint(float u, float v)> at;
};

// A quadrilateral (or, with corner 2 repeated as 3, a triangle) of a surface:
// texture coordinates run affinely, uv = uv0 + s du + t dv, where s runs from
// corner 0 to 1 and t from corner 0 to 3.
struct Quad {
  std::array<Eigen::Vector3f, 4> corners_world;
  Eigen::Vector2f uv0;
  Eigen::Vector2f du;
  Eigen::Vector2f dv;
  Eigen::Vector3f normal_world;
  int surface = 0;
};

struct SceneModel {
  std::vector<Surface> surfaces;
  std::vector<Quad> quads;
  Eigen::Vector3f to_sun;  // unit
};

inline constexpr float kHalfYard_m = 13.0F;

// World: metres, z up, the terrain about z = 0, walls at |x|, |y| =
// kHalfYard_m. What stands in the yard is lifted with the ground below it.
//   detail  1 = textures for images of 1280 px width; less for smaller ones.
SceneModel BuildYard(const Terrain& terrain,
                     std::uint64_t seed,
                     float detail,
                     int threads);

// The remote-controlled car, in its own frame: x forward, y left, z up, origin
// on the ground below its middle. It fills its cuboid.
inline constexpr float kCarLength_m = 0.9F;
inline constexpr float kCarWidth_m = 0.5F;
inline constexpr float kCarHeight_m = 0.35F;
struct CarFace {
  std::array<Eigen::Vector3f, 4> corners_car;
  Eigen::Vector3f normal_car;
  Eigen::Vector3f color_bgr;  // linear, 0 to 1
  float gloss = 0.0F;
};
std::vector<CarFace> BuildCar();

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SCENE_MODEL_H_
