// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/agreement.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <utility>
#include <vector>

namespace groundlock::localization {
namespace {

// About the reach of the descriptors of small features. Of 32 squares, two of
// 16 right starts beside a symmetric facade had 83 places against 30 of the
// decoy: too few to tell; what agrees by chance lies in 12 at most (37
// matches).
constexpr int kSquaresAlongSide = 40;
// Poses that a frame's search looks at, at most: four places by each of three
// sets of features, and what was predicted.
constexpr double kHypotheses = 16.0;

// log P(X >= k) of a binomial X of n trials.
double LogBinomialTail(int n, int k, double p) {
  if (k <= 0) return 0.0;
  double log_first = k * std::log(p) + (n - k) * std::log1p(-p);
  for (int i = 1; i <= k; ++i) {
    log_first += std::log(static_cast<double>(n - k + i) / i);
  }
  // The later ones, relative to the first.
  double sum = 1.0;
  double term = 1.0;
  for (int i = k; i < n; ++i) {
    term *= (n - i) / (i + 1.0) * p / (1.0 - p);
    sum += term;
  }
  return std::min(0.0, log_first + std::log(sum));
}

// The square in which a pixel lies; nullopt outside the image.
std::optional<int> SquareAt(const Eigen::Vector2d& pixel_px,
                            const geometry::CameraModel& camera) {
  if (!camera.IsInsideImage(pixel_px)) return std::nullopt;
  const double side_px = std::max(camera.width_px(), camera.height_px()) /
                         static_cast<double>(kSquaresAlongSide);
  return static_cast<int>(pixel_px.y() / side_px) * kSquaresAlongSide +
         static_cast<int>(pixel_px.x() / side_px);
}

}  // namespace

int CountPlaces(std::span<const Eigen::Vector2d> pixels_px,
                const geometry::CameraModel& camera) {
  std::vector<int> squares;
  squares.reserve(pixels_px.size());
  for (const Eigen::Vector2d& pixel_px : pixels_px) {
    if (const auto square = SquareAt(pixel_px, camera)) {
      squares.push_back(*square);
    }
  }
  std::sort(squares.begin(), squares.end());
  return static_cast<int>(std::unique(squares.begin(), squares.end()) -
                          squares.begin());
}

double LogFalseAlarms(const Agreement& agreement, double chance) {
  // What was found may lie in a square more than what was looked for.
  const int places = std::max(agreement.places, agreement.agreeing);
  return std::log(kHypotheses) +
         LogBinomialTail(places, agreement.agreeing, chance);
}

Agreement AgreementOverDecoy(std::span<const Likeness> pose,
                             std::span<const Likeness> decoy,
                             const geometry::CameraModel& camera) {
  constexpr int kNone = std::numeric_limits<int>::max();
  // By square, how unlike the best of either is.
  std::map<int, std::pair<int, int>> best;
  const auto enter = [&](std::span<const Likeness> matches,
                         int std::pair<int, int>::*side) {
    for (const Likeness& match : matches) {
      const auto square = SquareAt(match.pixel_px, camera);
      if (!square) continue;
      int& least = best.try_emplace(*square, kNone, kNone).first->second.*side;
      least = std::min(least, match.squared_distance);
    }
  };
  enter(pose, &std::pair<int, int>::first);
  enter(decoy, &std::pair<int, int>::second);
  Agreement agreement;
  for (const auto& [square, distances] : best) {
    if (distances.first == distances.second) continue;
    ++agreement.places;
    agreement.agreeing += distances.first < distances.second ? 1 : 0;
  }
  return agreement;
}

double LogFalseAlarmsOverDecoy(const Agreement& agreement) {
  return LogFalseAlarms(agreement, 0.5);
}

bool IsSure(double log_false_alarms) {
  return log_false_alarms <= std::log(kFalseAlarmsOfSure);
}

double LogMargin(double log_false_alarms) {
  return std::log(kFalseAlarmsPerFrame) - log_false_alarms;
}

}  // namespace groundlock::localization
