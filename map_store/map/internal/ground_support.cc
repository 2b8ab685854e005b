// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/ground_support.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "map_store/map/internal/ground_fit.h"

namespace groundlock::map::internal {
namespace {

using geometry::Plane;

// More landmarks lie on the ground than in a layer as thick right above it, by
// so many sigmas of the two counts; walls alone have as many at every height.
constexpr double kLeastPeak = 4.0;
// Landmarks all around: the scatter of that many neighbours across the line
// they are nearest to is more than this share of that along it (even places
// have 0.41 in the median, 97 % of them more than this share; a wall's foot
// that is scattered by half the distance of its places has 0.07).
constexpr std::size_t kNeighbours = 8;
constexpr double kLeastSpread = 0.1;
// Ground had 0.82 to 0.97 of its landmarks so (flights, rendered yards), walls
// alone up to 0.1.
constexpr double kLeastShareSpread = 0.5;
constexpr std::size_t kMaxSpread = 1'000;
// Parallel planes that are reckoned with: up to half the cameras' height away.
constexpr int kLevels = 50;
constexpr double kLevelStep = 0.01;

// Landmarks in the plane's layer, and in the one as thick right above it.
struct Layers {
  double on = 0.0;
  double above = 0.0;
};
Layers CountLayers(const GroundScene& scene, const Plane& plane) {
  Layers layers;
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    const double distance =
        plane.SignedDistance(scene.points[i]) / scene.tolerances[i];
    if (std::abs(distance) < 1.0) {
      ++layers.on;
    } else if (distance > 0.0 && distance < 3.0) {
      ++layers.above;
    }
  }
  return layers;
}

// Share of the plane's landmarks whose neighbours on it lie all around and not
// along a line. A plane that walls cut through has lines of landmarks only.
double ShareSpread(const GroundScene& scene, const Plane& plane) {
  std::vector<std::size_t> on = PointsWithin(scene, plane, 1.0);
  if (on.size() > kMaxSpread) on.resize(kMaxSpread);  // a random part
  if (on.size() <= kNeighbours) return 0.0;
  const Eigen::Vector3d x = plane.normal.unitOrthogonal();
  Eigen::Matrix<double, 2, 3> flat;
  flat << x.transpose(), plane.normal.cross(x).transpose();
  std::vector<Eigen::Vector2d> places;
  for (const std::size_t i : on) places.push_back(flat * scene.points[i]);
  std::size_t spread = 0;
  std::vector<std::pair<double, std::size_t>> near(places.size());
  for (const Eigen::Vector2d& place : places) {
    for (std::size_t i = 0; i < places.size(); ++i) {
      near[i] = {(places[i] - place).squaredNorm(), i};
    }
    std::nth_element(near.begin(), near.begin() + kNeighbours, near.end());
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (std::size_t i = 0; i <= kNeighbours; ++i) {
      mean += places[near[i].second] / (kNeighbours + 1.0);
    }
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
    for (std::size_t i = 0; i <= kNeighbours; ++i) {
      const Eigen::Vector2d d = places[near[i].second] - mean;
      scatter += d * d.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(
        scatter, Eigen::EigenvaluesOnly);
    spread += eigen.eigenvalues()[0] > kLeastSpread * eigen.eigenvalues()[1];
  }
  return static_cast<double>(spread) / static_cast<double>(places.size());
}

}  // namespace

bool StandsOut(const GroundScene& scene, const Plane& plane) {
  const Layers layers = CountLayers(scene, plane);
  return layers.on - layers.above >=
             kLeastPeak * std::sqrt(layers.on + layers.above) &&
         ShareSpread(scene, plane) >= kLeastShareSpread;
}

double HeightSigmaShare(const GroundScene& scene,
                        const Plane& plane,
                        const std::function<double(const Plane&)>& weight_of) {
  const double height = MeanHeight(scene, plane);
  if (!(height > 0.0)) return 1.0;
  double weights = 0.0;
  double sum = 0.0;
  for (int i = -kLevels; i <= kLevels; ++i) {
    const double share = kLevelStep * i;
    Plane other = plane;
    other.d -= share * height;
    const double weight = weight_of(other);
    weights += weight;
    sum += weight * share * share;
  }
  return weights > 0.0 ? std::sqrt(sum / weights) : 1.0;
}

}  // namespace groundlock::map::internal
