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
// Where the target is not.
constexpr double kUnknownStep_px = 40.0;
constexpr double kLeastStep_px = 1e-3;
// Steps are so many times wider where there would be too many places.
constexpr double kWiden = 1.5;

// In a row of an image. nullopt: the target is nowhere in it.
std::optional<double> LeastStepY(const StepAt& step_at,
                                 double y_px,
                                 double width_px) {
  constexpr int kSamples = 5;
  std::optional<double> least_px;
  for (int i = 0; i < kSamples; ++i) {
    const auto step_px = step_at({(i + 0.5) * width_px / kSamples, y_px});
    if (step_px) least_px = std::min(step_px->y(), least_px.value_or(1e9));
  }
  return least_px;
}

// The grid whose steps are so many times as wide; up to one place too many.
std::vector<Eigen::Vector2d> WidenedPlaces(const StepAt& step_at,
                                           const Eigen::Vector2d& size_px,
                                           double times) {
  std::vector<Eigen::Vector2d> places;
  double height_px = kUnknownStep_px;
  for (double top_px = 0.0; top_px < size_px.y(); top_px += height_px) {
    // As high as the target is about the row's middle, which hangs on that.
    bool is_empty = true;
    for (int round = 0; round < 2; ++round) {
      const double middle_px =
          std::min(top_px + 0.5 * height_px, size_px.y() - 1.0);
      const auto step_px = LeastStepY(step_at, middle_px, size_px.x());
      is_empty = !step_px;
      height_px = std::max(1.0, times * step_px.value_or(kUnknownStep_px));
    }
    if (is_empty) continue;
    const double y_px = std::min(top_px + 0.5 * height_px, size_px.y() - 1.0);
    double width_px = kUnknownStep_px;
    for (double left_px = 0.0; left_px < size_px.x(); left_px += width_px) {
      const double x_px = std::min(left_px + 0.5 * width_px, size_px.x() - 1.0);
      const auto step_px = step_at({x_px, y_px});
      width_px =
          std::max(1.0, times * (step_px ? step_px->x() : kUnknownStep_px));
      if (!step_px) continue;
      places.emplace_back(std::min(left_px + 0.5 * width_px, size_px.x() - 1.0),
                          y_px);
      if (places.size() > static_cast<std::size_t>(kMaxImagePlaces)) {
        return places;
      }
    }
  }
  return places;
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
  // No step is none that would never become wide enough.
  const StepAt positive_at = [&](const Eigen::Vector2d& pixel_px) {
    auto step_px = step_at(pixel_px);
    if (step_px && !(step_px->minCoeff() > kLeastStep_px)) step_px.reset();
    return step_px;
  };
  double times = 1.0;
  auto places = WidenedPlaces(positive_at, size_px, times);
  while (places.size() > static_cast<std::size_t>(kMaxImagePlaces)) {
    times *= kWiden;
    places = WidenedPlaces(positive_at, size_px, times);
  }
  return places;
}

}  // namespace groundlock::tracking
