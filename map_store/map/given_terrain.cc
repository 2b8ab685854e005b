// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/given_terrain.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "map_store/base/order_statistics.h"
#include "map_store/geometry/plane.h"

namespace groundlock::map {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// A spline's value at a knot is three quarters of its coefficient and an eighth
// of each neighbour's, along either axis. Coefficients that give the heights
// are found by adding what is missing; what changes from knot to knot, slowest,
// is then there to a thousandth.
constexpr int kRounds = 24;
// Landmarks of the ground lie in a band so wide, of the cameras' height over
// the terrain, and no narrower than that: metres.
constexpr double kBandShare = 0.05;
constexpr double kLeastBand = 0.1;
// There are at least so many of them, and twice as many as the bands above hold
// in the mean, where walls have landmarks at all heights.
constexpr std::size_t kLeastGround = 50;
constexpr double kDenser = 2.0;
constexpr double kBandsAbove = 5.0;
// By which a median of absolute differences becomes a sigma.
constexpr double kSigmaOfMedian = 1.4826;

// Of p over the terrain; nullopt where that is not known.
std::optional<double> HeightOver(const GroundRelief& relief,
                                 const Vector3d& p_world) {
  const auto known = relief.At(p_world.head<2>());
  if (!known) return std::nullopt;
  return p_world.z() - known->height;
}

// The mean over the neighbours that are known, where a height itself is not: a
// spline beside a hole needs one. nullopt: none is.
std::optional<double> NeighboursMean(const GivenTerrain& terrain,
                                     std::size_t row,
                                     std::size_t column) {
  double sum = 0.0;
  int count = 0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const std::size_t y = row + static_cast<std::size_t>(dy);
      const std::size_t x = column + static_cast<std::size_t>(dx);
      if (y >= terrain.rows() || x >= terrain.columns) continue;
      const double z = terrain.z[y * terrain.columns + x];
      if (std::isnan(z)) continue;
      sum += z;
      ++count;
    }
  }
  if (count == 0) return std::nullopt;
  return sum / count;
}

// What a spline of these coefficients is at each knot; at the rim its outer
// neighbours are as it is.
std::vector<double> AtKnots(const std::vector<double>& coefficients,
                            std::size_t columns) {
  const std::size_t rows = coefficients.size() / columns;
  std::vector<double> along(coefficients.size());
  for (std::size_t y = 0; y < rows; ++y) {
    const double* from = &coefficients[y * columns];
    double* to = &along[y * columns];
    for (std::size_t x = 0; x < columns; ++x) {
      to[x] = 0.75 * from[x] + 0.125 * (from[x == 0 ? 0 : x - 1] +
                                        from[std::min(x + 1, columns - 1)]);
    }
  }
  std::vector<double> values(coefficients.size());
  for (std::size_t y = 0; y < rows; ++y) {
    const double* before = &along[(y == 0 ? 0 : y - 1) * columns];
    const double* after = &along[std::min(y + 1, rows - 1) * columns];
    for (std::size_t x = 0; x < columns; ++x) {
      values[y * columns + x] =
          0.75 * along[y * columns + x] + 0.125 * (before[x] + after[x]);
    }
  }
  return values;
}

}  // namespace

absl::Status GivenTerrain::Validate() const {
  const auto refuse = [](std::string_view what) {
    return absl::InvalidArgumentError(
        absl::StrCat("terrain: ", std::string(what)));
  };
  if (columns < GroundRelief::kMinSide || rows() < GroundRelief::kMinSide ||
      columns * rows() != z.size()) {
    return refuse("needs whole rows, at least 3 of at least 3 heights");
  }
  if (z.size() > GroundRelief::kMaxKnots) {
    return absl::InvalidArgumentError(absl::StrCat(
        "terrain: ", z.size(), " heights, at most ", GroundRelief::kMaxKnots));
  }
  if (!first.allFinite() || !(step > 0.0) || !std::isfinite(step)) {
    return refuse("its grid's place or step is out of range");
  }
  if (!(sigma >= 0.0) || !std::isfinite(sigma)) {
    return refuse("sigma must be >= 0");
  }
  bool known = false;
  for (const float height : z) {
    if (std::isinf(height)) return refuse("holds an infinite height");
    known = known || !std::isnan(height);
  }
  if (!known) return refuse("none of its heights is known");
  return absl::OkStatus();
}

GroundRelief ReliefOf(const GivenTerrain& terrain,
                      double height,
                      double sigma) {
  GroundRelief relief;
  relief.origin_plane = terrain.first;
  relief.step = terrain.step;
  relief.columns = terrain.columns;
  relief.knots.resize(terrain.z.size());
  std::vector<double> heights(terrain.z.size(), 0.0);
  std::vector<bool> wanted(terrain.z.size(), false);
  for (std::size_t i = 0; i < terrain.z.size(); ++i) {
    const double z = terrain.z[i];
    const auto filled =
        std::isnan(z)
            ? NeighboursMean(terrain, i / terrain.columns, i % terrain.columns)
            : std::optional<double>(z);
    wanted[i] = filled.has_value();
    if (filled) heights[i] = *filled - height;
    relief.knots[i].sigma = std::isnan(z)
                                ? std::numeric_limits<float>::infinity()
                                : static_cast<float>(sigma);
  }
  std::vector<double> coefficients = heights;
  for (int round = 0; round < kRounds; ++round) {
    const std::vector<double> values = AtKnots(coefficients, terrain.columns);
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (wanted[i]) coefficients[i] += heights[i] - values[i];
    }
  }
  for (std::size_t i = 0; i < coefficients.size(); ++i) {
    relief.knots[i].coefficient = static_cast<float>(coefficients[i]);
  }
  return relief;
}

std::optional<TerrainAgreement> CompareWithLandmarks(
    const GivenTerrain& terrain, const MapData& data) {
  const GroundRelief relief = ReliefOf(terrain, 0.0, 0.0);
  std::vector<double> over;
  for (const MapLandmarkData& landmark : data.landmarks) {
    const auto height = HeightOver(relief, landmark.p_world);
    if (height) over.push_back(*height);
  }
  std::vector<double> cameras_over;
  for (const MapViewData& view : data.views) {
    const auto height =
        HeightOver(relief, view.camera_from_world.Inverse().translation);
    if (height) cameras_over.push_back(*height);
  }
  if (over.size() < kLeastGround || cameras_over.empty()) return std::nullopt;
  // A wrong datum moves cameras and landmarks alike.
  const double camera_height =
      std::abs(base::Median(std::move(cameras_over)) - base::Median(over));
  const double band = std::max(kLeastBand, kBandShare * camera_height);
  std::sort(over.begin(), over.end());
  std::size_t best_first = 0;
  std::size_t best_count = 0;
  std::size_t end = 0;
  for (std::size_t first = 0; first < over.size(); ++first) {
    while (end < over.size() && over[end] - over[first] <= band) ++end;
    if (end - first <= best_count) continue;
    best_first = first;
    best_count = end - first;
  }
  const auto last =
      over.begin() + static_cast<std::ptrdiff_t>(best_first + best_count);
  const auto above =
      std::upper_bound(last, over.end(), *(last - 1) + kBandsAbove * band);
  if (best_count < kLeastGround ||
      static_cast<double>(best_count) <
          kDenser * static_cast<double>(above - last) / kBandsAbove) {
    return std::nullopt;
  }
  TerrainAgreement agreement;
  agreement.num_ground = best_count;
  agreement.num_landmarks = over.size();
  agreement.offset = over[best_first + best_count / 2];
  // By those below it alone: much stands on the ground, nothing under it.
  const auto ground =
      over.begin() + static_cast<std::ptrdiff_t>(best_first + best_count / 2);
  std::vector<double> depths;
  for (auto it = over.begin(); it != ground; ++it) {
    depths.push_back(agreement.offset - *it);
  }
  if (!depths.empty()) {
    agreement.scatter = kSigmaOfMedian * base::Median(std::move(depths));
  }
  return agreement;
}

double ShareBelow(const GivenTerrain& terrain,
                  double offset,
                  const MapData& data) {
  const GroundRelief relief = ReliefOf(terrain, 0.0, 0.0);
  int known = 0;
  int below = 0;
  for (const MapViewData& view : data.views) {
    const auto height =
        HeightOver(relief, view.camera_from_world.Inverse().translation);
    if (!height) continue;
    ++known;
    below += *height < offset ? 1 : 0;
  }
  return known == 0 ? std::numeric_limits<double>::quiet_NaN()
                    : static_cast<double>(below) / known;
}

}  // namespace groundlock::map
