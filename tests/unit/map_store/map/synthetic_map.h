// SPDX-License-Identifier: Apache-2.0
// A small map with known geometry: cameras walking around a ground with walls.
#ifndef GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_SYNTHETIC_MAP_H_
#define GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_SYNTHETIC_MAP_H_

#include <cmath>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "map_store/map/map_data.h"

namespace groundlock::map::testing_map {

struct SceneOptions {
  int num_ground = 300;
  int num_wall = 150;  // on two walls that stand on the ground
  int num_views = 8;
  double pitch_rad = 0.3;  // below the horizon; pi / 2 looks straight down
  double height_m = 1.6;
  double noise_m = 0.005;
  std::uint64_t seed = 1;
};

// World: metric, z up, ground z = 0. The views stand on a circle of 8 m and
// look inwards. The last landmark is seen by nobody.
inline MapData MakeMapData(const SceneOptions& options = {}) {
  std::mt19937_64 generator(options.seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, options.noise_m);
  MapData data;
  data.source_format = "synthetic";
  data.metric = true;
  const std::vector<double> params = {700, 640, 360, -0.05};
  data.cameras.push_back(*geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial, 1280, 720, params));
  for (int i = 0; i < options.num_ground; ++i) {
    data.landmarks.push_back(
        {{6.0 * uniform(generator), 6.0 * uniform(generator), noise(generator)},
         {90, 90, 90},
         0.5F});
  }
  for (int i = 0; i < options.num_wall; ++i) {
    const double along = 6.0 * uniform(generator);
    const double up = 1.5 + 1.5 * uniform(generator);
    const double off = 6.0 + noise(generator);
    data.landmarks.push_back({i % 2 == 0 ? Eigen::Vector3d(along, off, up)
                                         : Eigen::Vector3d(-off, along, up),
                              {200, 50, 50},
                              0.5F});
  }
  for (int v = 0; v < options.num_views; ++v) {
    MapViewData& view = data.views.emplace_back();
    view.name = "frame" + std::to_string(v) + ".jpg";
    const double angle = 6.283185307179586 * v / options.num_views;
    const Eigen::Vector3d outwards(std::cos(angle), std::sin(angle), 0.0);
    const Eigen::Vector3d z =
        -std::cos(options.pitch_rad) * outwards -
        std::sin(options.pitch_rad) * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d x(-outwards.y(), outwards.x(), 0.0);
    Eigen::Matrix3d world_from_camera;
    world_from_camera << x, z.cross(x), z;
    view.camera_from_world =
        geometry::Rigid3{
            Eigen::Quaterniond(world_from_camera),
            8.0 * outwards + options.height_m * Eigen::Vector3d::UnitZ()}
            .Inverse();
    for (std::uint32_t i = 0; i < data.landmarks.size(); ++i) {
      const std::optional<Eigen::Vector2d> pixel =
          data.cameras[0].ImageFromCamera(view.camera_from_world *
                                          data.landmarks[i].p_world);
      if (!pixel.has_value() || !data.cameras[0].IsInsideImage(*pixel)) {
        continue;
      }
      view.keypoints_px.emplace_back(pixel->cast<float>());
      view.landmarks.push_back(i);
      Descriptor& descriptor = view.descriptors.emplace_back();
      for (std::uint8_t& value : descriptor) {
        value = static_cast<std::uint8_t>(generator() & 0x7FU);
      }
    }
  }
  data.landmarks.push_back({{0, 0, -1000}, {}, 0.0F});
  return data;
}

}  // namespace groundlock::map::testing_map

#endif  // GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_SYNTHETIC_MAP_H_
