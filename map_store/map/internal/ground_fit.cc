// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/ground_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

namespace groundlock::map::internal {
namespace {

using geometry::Plane;

constexpr std::size_t kStretches = 8;

double WeightOf(const GroundScene& scene, std::size_t i) {
  return 1.0 / (scene.tolerances[i] * scene.tolerances[i]);
}

std::vector<double> Weights(const GroundScene& scene,
                            const std::vector<std::size_t>& indices) {
  std::vector<double> weights;
  weights.reserve(indices.size());
  for (const std::size_t i : indices) weights.push_back(WeightOf(scene, i));
  return weights;
}

// The plane's landmarks in order along where they are spread most.
std::vector<std::size_t> AlongTheGround(const GroundScene& scene,
                                        const Plane& plane) {
  const std::vector<std::size_t> on = PointsWithin(scene, plane, 1.0);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const std::size_t i : on) {
    mean += scene.points[i] / static_cast<double>(on.size());
  }
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const std::size_t i : on) {
    const Eigen::Vector3d d = scene.points[i] - mean;
    scatter += d * d.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  const Eigen::Vector3d along = eigen.eigenvectors().col(2);
  std::vector<std::pair<double, std::size_t>> order;
  for (const std::size_t i : on) {
    order.emplace_back(along.dot(scene.points[i]), i);
  }
  std::sort(order.begin(), order.end());
  std::vector<std::size_t> indices;
  for (const auto& [place, i] : order) indices.push_back(i);
  return indices;
}

GroundScene Without(const GroundScene& scene,
                    std::vector<std::size_t> left_out) {
  std::sort(left_out.begin(), left_out.end());
  GroundScene rest;
  rest.centers = scene.centers;
  std::size_t next = 0;
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    if (next < left_out.size() && left_out[next] == i) {
      ++next;
      continue;
    }
    rest.points.push_back(scene.points[i]);
    rest.tolerances.push_back(scene.tolerances[i]);
  }
  return rest;
}

}  // namespace

Plane Narrowed(const GroundScene& scene, Plane plane) {
  for (const double band : {1.0, 0.8, 0.65, kGroundBand, kGroundBand}) {
    const std::vector<std::size_t> on = PointsWithin(scene, plane, band);
    const auto refined =
        geometry::FitPlane(Select(scene, on), Weights(scene, on));
    if (!refined.ok()) break;
    const auto oriented = TowardsCameras(scene, *refined);
    if (!oriented.has_value()) break;
    plane = *oriented;
  }
  return plane;
}

double MeanHeight(const GroundScene& scene, const Plane& plane) {
  double sum = 0.0;
  for (const Eigen::Vector3d& center : scene.centers) {
    sum += plane.SignedDistance(center);
  }
  return scene.centers.empty()
             ? 0.0
             : sum / static_cast<double>(scene.centers.size());
}

GroundSpread SpreadOfFit(const GroundScene& scene, const Plane& plane) {
  GroundSpread spread;
  const std::vector<std::size_t> on = AlongTheGround(scene, plane);
  if (on.size() < kStretches || scene.centers.empty()) return spread;
  std::vector<Plane> fits;
  Eigen::Vector3d mean_normal = Eigen::Vector3d::Zero();
  double mean_height = 0.0;
  for (std::size_t s = 0; s < kStretches; ++s) {
    const auto at = [&](std::size_t stretch) {
      return on.begin() +
             static_cast<std::ptrdiff_t>(stretch * on.size() / kStretches);
    };
    fits.push_back(Narrowed(Without(scene, {at(s), at(s + 1)}), plane));
    mean_normal += fits.back().normal / kStretches;
    mean_height += MeanHeight(scene, fits.back()) / kStretches;
  }
  double tilts = 0.0;
  double heights = 0.0;
  for (const Plane& fit : fits) {
    tilts += (fit.normal - mean_normal).squaredNorm();
    heights += std::pow(MeanHeight(scene, fit) - mean_height, 2.0);
  }
  const double share = (kStretches - 1.0) / kStretches;
  // A normal has two angles.
  spread.tilt_rad = std::sqrt(0.5 * share * tilts);
  spread.height = std::sqrt(share * heights);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double weights = 0.0;
  for (const std::size_t i : on) {
    middle += WeightOf(scene, i) * scene.points[i];
    weights += WeightOf(scene, i);
  }
  Eigen::Vector3d below = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& center : scene.centers) {
    below += center / static_cast<double>(scene.centers.size());
  }
  spread.lever =
      (plane.Project(middle / weights) - plane.Project(below)).norm();
  return spread;
}

}  // namespace groundlock::map::internal
