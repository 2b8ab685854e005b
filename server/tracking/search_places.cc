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
// Smaller parts of an image that have no step in their middle have none.
constexpr double kLeastPart_px = 40.0;
// Steps are so many times wider where there would be too many places.
constexpr double kWiden = 1.5;

// A part of an image, by its first corner and its size.
struct Part {
  Eigen::Vector2d corner_px;
  Eigen::Vector2d size_px;
};

// Adds the middles of a part's parts. False: there are too many.
bool AddPlaces(const Part& part,
               const StepAt& step_at,
               double widened,
               std::vector<Eigen::Vector2d>& places) {
  const Eigen::Vector2d middle_px = part.corner_px + 0.5 * part.size_px;
  const auto step_px = step_at(middle_px);
  Eigen::Vector2d least_px = Eigen::Vector2d::Constant(kLeastPart_px);
  if (step_px) least_px = (widened * *step_px).cwiseMax(1.0);
  const Eigen::Vector2d times = part.size_px.cwiseQuotient(least_px);
  int axis = 0;
  if (times.maxCoeff(&axis) <= 1.0) {
    if (step_px) places.push_back(middle_px);
    return places.size() <= static_cast<std::size_t>(kMaxImagePlaces);
  }
  Part half = part;
  half.size_px[axis] *= 0.5;
  if (!AddPlaces(half, step_at, widened, places)) return false;
  half.corner_px[axis] += half.size_px[axis];
  return AddPlaces(half, step_at, widened, places);
}

}  // namespace

std::vector<Eigen::Vector2d> SearchOffsets(
    const Eigen::Vector2d& step_px, const Eigen::Matrix2d& covariance_px2) {
  const Eigen::Vector2d& step = step_px;
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

std::vector<Eigen::Vector2d> ImagePlaces(const Eigen::Vector2d& step_px,
                                         const Eigen::Vector2d& size_px) {
  if (!(step_px.minCoeff() > 0.0) || !(size_px.minCoeff() > 0.0)) return {};
  const auto most = [](double wanted) {
    return static_cast<int>(std::clamp(std::ceil(wanted), 1.0, 4096.0));
  };
  int columns = most(size_px.x() / step_px.x());
  int rows = most(size_px.y() / step_px.y());
  const double widen =
      std::sqrt(static_cast<double>(columns) * rows / kMaxImagePlaces);
  if (widen > 1.0) {
    columns = std::max(1, static_cast<int>(columns / widen));
    rows = std::clamp(static_cast<int>(rows / widen),
                      1,
                      std::max(1, kMaxImagePlaces / columns));
    columns = std::min(columns, kMaxImagePlaces / rows);
  }
  std::vector<Eigen::Vector2d> places;
  places.reserve(static_cast<std::size_t>(columns) * rows);
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < columns; ++x) {
      places.emplace_back((x + 0.5) * size_px.x() / columns,
                          (y + 0.5) * size_px.y() / rows);
    }
  }
  return places;
}

std::vector<Eigen::Vector2d> ImagePlaces(const StepAt& step_at,
                                         const Eigen::Vector2d& size_px) {
  if (!(size_px.minCoeff() > 0.0) || !size_px.allFinite()) return {};
  std::vector<Eigen::Vector2d> places;
  double widened = 1.0;
  while (!AddPlaces(
      {Eigen::Vector2d::Zero(), size_px}, step_at, widened, places)) {
    places.clear();
    widened *= kWiden;
  }
  return places;
}

}  // namespace groundlock::tracking
