// SPDX-License-Identifier: Apache-2.0
// A flight along a street, as tracks and features show it, with its truth.
#ifndef GROUNDLOCK_TESTS_UNIT_MAP_STORE_BUILD_SYNTHETIC_FLIGHT_H_
#define GROUNDLOCK_TESTS_UNIT_MAP_STORE_BUILD_SYNTHETIC_FLIGHT_H_

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/track_scene.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

inline constexpr int kWidth_px = 1'280;
inline constexpr int kHeight_px = 720;

struct Flight {
  geometry::CameraModel lens;
  std::vector<geometry::Rigid3> camera_from_world;
  FeatureTracks tracks;
  std::vector<ImageFeatures> features;  // per image
};

struct FlightOptions {
  int num_images = 24;
  double step_m = 1.5;         // forward, per image
  double turn_rad = 0.02;      // about the vertical, per image
  double share_moving = 0.25;  // of the points: they drive along
  double noise_px = 0.3;
  // From which image to which it turns on the spot, by spin_rad per image.
  int spin_from = 0;
  int spin_to = 0;
  double spin_rad = 0.0;
  // There is as much to be seen beside and behind as ahead.
  bool is_all_around = false;
  // No track leads from the images before it to those from it on; 0 = none is
  // cut.
  std::uint32_t cut_at = 0;
  std::uint64_t seed = 3;
};

// A drone 12 m up flies along a street between walls and looks ahead and down;
// a quarter of what it sees drives.
inline Flight Fly(const FlightOptions& options) {
  std::mt19937_64 generator(options.seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, options.noise_px);
  Flight flight;
  flight.lens = *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial,
      kWidth_px,
      kHeight_px,
      std::vector<double>{905.0, 0.5 * kWidth_px, 0.5 * kHeight_px, -0.03});
  double heading = -0.2;
  Eigen::Vector3d center(0.0, 0.0, 12.0);
  for (int i = 0; i < options.num_images; ++i) {
    const Eigen::Vector3d ahead(std::cos(heading), std::sin(heading), 0.0);
    const Eigen::Vector3d z =
        (ahead - 0.4 * Eigen::Vector3d::UnitZ()).normalized();
    const Eigen::Vector3d x = ahead.cross(Eigen::Vector3d::UnitZ());
    Eigen::Matrix3d world_from_camera;
    world_from_camera << x, z.cross(x), z;
    flight.camera_from_world.push_back(
        geometry::Rigid3{Eigen::Quaterniond(world_from_camera), center}
            .Inverse());
    if (i >= options.spin_from && i < options.spin_to) {
      heading += options.spin_rad;
      continue;
    }
    center += options.step_m * ahead;
    heading += options.turn_rad;
  }
  flight.tracks.width_px = kWidth_px;
  flight.tracks.height_px = kHeight_px;
  flight.tracks.num_images = static_cast<std::uint32_t>(options.num_images);
  flight.features.resize(flight.tracks.num_images);
  for (std::uint32_t k = 0; k < flight.tracks.num_images; ++k) {
    flight.features[k].name = "image" + std::to_string(k);
    flight.features[k].width_px = kWidth_px;
    flight.features[k].height_px = kHeight_px;
  }
  std::mt19937_64 looks(options.seed);
  const int num_points = options.is_all_around ? 5'000 : 1'500;
  const Eigen::Vector2d middle(options.is_all_around ? 15.0 : 60.0, 0.0);
  const Eigen::Vector2d reach(options.is_all_around ? 80.0 : 60.0,
                              options.is_all_around ? 80.0 : 30.0);
  for (int i = 0; i < num_points; ++i) {
    Eigen::Vector3d p(middle.x() + reach.x() * uniform(generator),
                      middle.y() + reach.y() * uniform(generator),
                      0.0);
    if (i % 3 == 0) {
      p.y() = std::copysign(20.0, p.y());
      p.z() = 5.0 + 5.0 * uniform(generator);
    }
    const bool moves = uniform(generator) < 2.0 * options.share_moving - 1.0;
    map::Descriptor look;
    for (auto& value : look) value = static_cast<std::uint8_t>(looks() % 100);
    FeatureTrack track;
    for (std::uint32_t k = 0; k < flight.tracks.num_images; ++k) {
      Eigen::Vector3d now = p;
      if (moves) now.x() += 2.5 * k;
      const auto pixel =
          flight.lens.ImageFromCamera(flight.camera_from_world[k] * now);
      if (!pixel || !flight.lens.IsInsideImage(*pixel)) continue;
      track.push_back(
          {k,
           (*pixel + Eigen::Vector2d{noise(generator), noise(generator)})
               .cast<float>()});
      ImageFeatures& features = flight.features[k];
      features.keypoints_px.push_back(track.back().pixel_px);
      features.descriptors.push_back(look);
      features.rgb.push_back({128, 128, 128});
    }
    // Followed for a while only, and taken up at any time.
    std::erase_if(track, [&](const TrackSight& sight) {
      const auto start =
          static_cast<std::uint32_t>(i) % flight.tracks.num_images;
      return sight.image < start || sight.image >= start + 10 ||
             (start < options.cut_at && sight.image >= options.cut_at);
    });
    if (track.size() >= 2) flight.tracks.tracks.push_back(std::move(track));
  }
  return flight;
}

// How far rotations between images differ from the true ones, at most, rad.
inline double WorstTurn_rad(const Flight& flight, const TrackScene& scene) {
  double worst = 0.0;
  for (std::size_t i = 1; i < flight.camera_from_world.size(); ++i) {
    const Eigen::Quaterniond truth =
        flight.camera_from_world[i].rotation *
        flight.camera_from_world[0].rotation.conjugate();
    const Eigen::Quaterniond found =
        scene.camera_from_world[i]->rotation *
        scene.camera_from_world[0]->rotation.conjugate();
    worst = std::max(worst, geometry::AngleBetween_rad(truth, found));
  }
  return worst;
}

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_TESTS_UNIT_MAP_STORE_BUILD_SYNTHETIC_FLIGHT_H_
