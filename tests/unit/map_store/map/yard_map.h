// SPDX-License-Identifier: Apache-2.0
// Maps of a yard with ground of any shape.
#ifndef GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_YARD_MAP_H_
#define GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_YARD_MAP_H_

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <random>
#include <string>

#include "map_store/map/map_data.h"

namespace groundlock::map::testing_map {

inline constexpr double kHalfSide_m = 12.0;
inline constexpr double kNoise_m = 0.01;

inline double Hills(double x, double y) {
  return 0.7 * std::sin(0.4 * x + 0.3) * std::cos(0.35 * y - 0.8);
}
inline double Level(double, double) { return 0.0; }

// Landmarks on the ground, on the walls around it and on a block that stands in
// the middle, seen by cameras at a man's height.
inline MapData Yard(const std::function<double(double, double)>& height_m) {
  constexpr std::array<double, 3> kParams = {900.0, 640.0, 360.0};
  MapData data;
  data.cameras.push_back(*geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, kParams));
  data.in_world = true;
  data.metric = true;
  std::mt19937_64 random(5);
  const auto unit = [&] {
    return 2.0 * static_cast<double>(random() >> 11U) * 0x1.0p-53 - 1.0;
  };
  const auto add = [&](double x, double y, double above_m) {
    data.landmarks.push_back(
        {{x, y, height_m(x, y) + above_m + kNoise_m * unit()}, {}, 0.0F});
  };
  for (int i = 0; i < 1'800; ++i) {
    const double x = kHalfSide_m * unit();
    const double y = kHalfSide_m * unit();
    if (std::max(std::abs(x), std::abs(y)) > 1.0) add(x, y, 0.0);
  }
  for (int i = 0; i < 700; ++i) {  // walls
    const double along = kHalfSide_m * unit();
    const double above_m = 2.0 + 2.0 * unit();
    const double side = i % 2 == 0 ? kHalfSide_m : -kHalfSide_m;
    if (i % 4 < 2) {
      add(along, side, above_m);
    } else {
      add(side, along, above_m);
    }
  }
  for (int i = 0; i < 150; ++i) {  // the block's top
    const double x = unit();
    const double y = unit();
    add(x, y, 1.2);
  }
  for (int view = 0; view < 4; ++view) {
    const Eigen::Vector3d eye(view % 2 == 0 ? 5.0 : -5.0,
                              view < 2 ? 5.0 : -5.0,
                              1.6 + height_m(5.0, 5.0));
    MapViewData& seen = data.views.emplace_back();
    seen.name = std::to_string(view);
    seen.camera_from_world =
        geometry::Rigid3{Eigen::Quaterniond::Identity(), eye}.Inverse();
    for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
      seen.keypoints_px.emplace_back(1.0F, 1.0F);
      seen.landmarks.push_back(static_cast<std::uint32_t>(i));
    }
  }
  return data;
}

}  // namespace groundlock::map::testing_map

#endif  // GROUNDLOCK_TESTS_UNIT_MAP_STORE_MAP_YARD_MAP_H_
