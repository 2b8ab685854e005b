// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/search_places.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <utility>

namespace groundlock::tracking {
namespace {

constexpr double kSigmas = 2.0;
// Rings of the grid looked at, whatever the covariance: (2 * 8 + 1)^2 places.
constexpr int kMaxRings = 8;

}  // namespace

std::vector<Eigen::Vector2d> SearchOffsets(
    const Eigen::Vector2d& box_size_px, const Eigen::Matrix2d& covariance_px2) {
  const Eigen::Vector2d step = 0.5 * box_size_px;
  if (!covariance_px2.allFinite() || !(step.minCoeff() > 0.0)) return {};
  // The grid itself has an extent: an ellipse thinner than a step still reaches
  // its nearest neighbours in the other direction.
  const Eigen::Matrix2d spread =
      covariance_px2 + Eigen::Matrix2d((step / 4.0).cwiseAbs2().asDiagonal());
  const Eigen::Matrix2d information = spread.inverse();
  const auto rings = [&](int axis) {
    const double reach = kSigmas * std::sqrt(spread(axis, axis)) / step[axis];
    return static_cast<int>(std::min<double>(std::floor(reach), kMaxRings));
  };
  std::vector<std::pair<double, Eigen::Vector2d>> places;
  for (int j = -rings(1); j <= rings(1); ++j) {
    for (int i = -rings(0); i <= rings(0); ++i) {
      if (i == 0 && j == 0) continue;
      const Eigen::Vector2d offset = step.cwiseProduct(Eigen::Vector2d(i, j));
      const double distance = offset.dot(information * offset);
      if (distance <= kSigmas * kSigmas) places.emplace_back(distance, offset);
    }
  }
  std::stable_sort(
      places.begin(), places.end(), [](const auto& a, const auto& b) {
        return a.first < b.first;
      });
  if (places.size() > kMaxSearchPlaces) places.resize(kMaxSearchPlaces);
  std::vector<Eigen::Vector2d> offsets;
  offsets.reserve(places.size());
  for (const auto& [distance, offset] : places) offsets.push_back(offset);
  return offsets;
}

}  // namespace groundlock::tracking
