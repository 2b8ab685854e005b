// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/ground_scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <random>
#include <set>

namespace groundlock::map::internal {
namespace {

// At 10 m: 10 cm. A landmark's error across the view is some thousandths of
// its distance; the rest is for a ground that is not quite flat.
constexpr double kToleranceShare = 0.01;
// Side of a grid cell as a share of the median distance of the landmarks.
constexpr double kCellShare = 0.01;
// Robinson 2014, §3.3: landmarks seen by fewer are not trusted.
constexpr int kMinObservations = 3;
// With fewer trusted landmarks than this, the others are used as well.
constexpr std::size_t kMinTrusted = 100;
// Cameras that must stand on one side of the ground.
constexpr double kMinCamerasAbove = 0.95;

struct Candidate {
  Eigen::Vector3d point;
  double distance = 0.0;
};

std::vector<Candidate> Candidates(const MapData& data,
                                  const std::vector<Eigen::Vector3d>& centers,
                                  int min_observations) {
  std::vector<double> sums(data.landmarks.size(), 0.0);
  std::vector<int> counts(data.landmarks.size(), 0);
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    for (const std::uint32_t landmark : data.views[v].landmarks) {
      sums[landmark] += (data.landmarks[landmark].p_world - centers[v]).norm();
      ++counts[landmark];
    }
  }
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    if (counts[i] >= min_observations && sums[i] > 0.0) {
      candidates.push_back({data.landmarks[i].p_world, sums[i] / counts[i]});
    }
  }
  return candidates;
}

}  // namespace

std::vector<std::size_t> PointsWithin(const GroundScene& scene,
                                      const geometry::Plane& plane,
                                      double num_tolerances) {
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    if (std::abs(plane.SignedDistance(scene.points[i])) <
        num_tolerances * scene.tolerances[i]) {
      indices.push_back(i);
    }
  }
  return indices;
}

std::vector<Eigen::Vector3d> Select(const GroundScene& scene,
                                    const std::vector<std::size_t>& indices) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(indices.size());
  for (const std::size_t i : indices) points.push_back(scene.points[i]);
  return points;
}

std::optional<geometry::Plane> TowardsCameras(const GroundScene& scene,
                                              geometry::Plane plane) {
  std::size_t above = 0;
  for (const Eigen::Vector3d& center : scene.centers) {
    if (plane.SignedDistance(center) > 0.0) ++above;
  }
  const std::size_t count = scene.centers.size();
  if (2 * above < count) {
    plane = plane.Flipped();
    above = count - above;
  }
  if (static_cast<double>(above) <
      kMinCamerasAbove * static_cast<double>(count)) {
    return std::nullopt;
  }
  return plane;
}

GroundScene MakeGroundScene(const MapData& data, std::uint64_t seed) {
  GroundScene scene;
  for (const MapViewData& view : data.views) {
    scene.centers.push_back(view.camera_from_world.Inverse().translation);
    scene.camera_from_world.push_back(view.camera_from_world);
  }
  std::vector<Candidate> candidates =
      Candidates(data, scene.centers, kMinObservations);
  if (candidates.size() < kMinTrusted) {
    candidates = Candidates(data, scene.centers, 1);
  }
  if (candidates.empty()) return scene;

  std::vector<double> distances;
  distances.reserve(candidates.size());
  for (const Candidate& c : candidates) distances.push_back(c.distance);
  const auto middle =
      distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  const double cell = kCellShare * *middle;
  // Fisher-Yates with our own draws: std::shuffle differs between libraries.
  std::mt19937_64 generator(seed);
  for (std::size_t i = candidates.size(); i > 1; --i) {
    std::swap(candidates[i - 1], candidates[((generator() >> 32U) * i) >> 32U]);
  }
  std::set<std::array<double, 3>> occupied;
  for (const Candidate& candidate : candidates) {
    const Eigen::Vector3d index = (candidate.point / cell).array().floor();
    if (!occupied.insert({index.x(), index.y(), index.z()}).second) continue;
    scene.points.push_back(candidate.point);
    scene.tolerances.push_back(kToleranceShare * candidate.distance);
  }
  return scene;
}

}  // namespace groundlock::map::internal
