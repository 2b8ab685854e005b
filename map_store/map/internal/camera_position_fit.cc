// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/camera_position_fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "map_store/base/order_statistics.h"
#include "map_store/base/status.h"
#include "map_store/geometry/robust_similarity.h"

namespace groundlock::map::internal {
namespace {

using Points = std::span<const Eigen::Vector3d>;

// Cameras must spread by so many times the positions' noise, or it would turn
// the map.
constexpr double kMinSpread = 3.0;
// From one accuracy that is tried to the next.
constexpr double kStep = 1.5;

// Metres per unit of the map, from the distances between positions that are far
// apart in the list; the median bears with wrong ones.
double ApproximateScale(Points p_world, Points p_measured) {
  std::vector<double> ratios;
  const std::size_t count = p_world.size();
  for (std::size_t i = 0; i < count; ++i) {
    for (const std::size_t step : {count / 2, count / 3}) {
      const std::size_t j = (i + step) % count;
      const double length = (p_world[j] - p_world[i]).norm();
      if (!(length > 0.0)) continue;
      ratios.push_back((p_measured[j] - p_measured[i]).norm() / length);
    }
  }
  return base::Median(std::move(ratios));
}

std::vector<Eigen::Vector3d> WithoutHeights(Points points) {
  std::vector<Eigen::Vector3d> flat(points.begin(), points.end());
  for (Eigen::Vector3d& p : flat) p.z() = 0.0;
  return flat;
}

absl::StatusOr<geometry::RobustSimilarity> FitInSpace(Points p_world,
                                                      Points p_measured,
                                                      double accuracy_m,
                                                      bool upright,
                                                      std::uint64_t seed) {
  geometry::RobustSimilarityOptions options;
  options.sigma = accuracy_m;
  options.upright = upright;
  options.seed = seed;
  return geometry::EstimateSimilarityRobustly(p_world, p_measured, options);
}

absl::StatusOr<geometry::RobustSimilarity> FitOnTheGround(Points p_world,
                                                          Points p_measured,
                                                          double accuracy_m,
                                                          std::uint64_t seed) {
  ASSIGN_OR_RETURN(auto fit,
                   FitInSpace(WithoutHeights(p_world),
                              WithoutHeights(p_measured),
                              accuracy_m,
                              /*upright=*/true,
                              seed));
  geometry::Similarity3& similarity = fit.target_from_source;
  std::vector<double> heights;
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    heights.push_back(p_measured[i].z() - similarity.scale * p_world[i].z());
  }
  similarity.translation.z() = base::Median(std::move(heights));
  return fit;
}

std::string HeightWarning(Points p_world,
                          Points p_measured,
                          const geometry::Similarity3& similarity) {
  double worst = 0.0;
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    worst = std::max(
        worst, std::abs((similarity * p_world[i]).z() - p_measured[i].z()));
  }
  return absl::StrFormat(
      "the heights contradict the map, by up to %.0f m, and were left out: "
      "took the map's z for up",
      worst);
}

}  // namespace

absl::StatusOr<CameraPositionFit> FitCameraPositions(Points p_world,
                                                     Points p_measured,
                                                     double accuracy_m,
                                                     std::uint64_t seed) {
  CameraPositionFit result;
  const Eigen::Vector3d spread = ApproximateScale(p_world, p_measured) *
                                 geometry::PrincipalSpread(p_world);
  if (spread(1) < kMinSpread * accuracy_m) {
    result.warnings.push_back(absl::StrFormat(
        "the images were taken nearly on a line (standard deviations %.1f m "
        "along, %.1f m across): took the map's z for up",
        spread(0),
        spread(1)));
  }
  if (spread(0) < kMinSpread * accuracy_m) {
    result.warnings.push_back(
        absl::StrFormat("the images spread over only %.1f m, at an accuracy of "
                        "%.1f m: scale and heading are uncertain",
                        spread(0),
                        accuracy_m));
  }
  absl::Status first_failure;
  double tried_m = accuracy_m;
  while (true) {
    const bool upright = spread(1) < kMinSpread * tried_m;
    auto fit = FitInSpace(p_world, p_measured, tried_m, upright, seed);
    // Beyond what was expected, heights are the first to be wrong, and they
    // would tilt the map.
    const bool loosened = tried_m > accuracy_m;
    if (!fit.ok() || loosened) {
      if (first_failure.ok()) first_failure = fit.status();
      auto flat = FitOnTheGround(p_world, p_measured, tried_m, seed);
      if (flat.ok()) {
        fit = std::move(flat);
        result.warnings.push_back(
            HeightWarning(p_world, p_measured, fit->target_from_source));
      }
    }
    if (fit.ok()) {
      if (loosened) {
        result.warnings.push_back(absl::StrFormat(
            "the positions agree with the map to %.1f m, not to the %.1f m "
            "that were expected: its scale may be off by %.1f %%, its heading "
            "by %.1f degrees",
            tried_m,
            accuracy_m,
            100.0 * tried_m / (spread(0) * std::sqrt(fit->num_inliers)),
            180.0 / M_PI * tried_m /
                (spread(0) * std::sqrt(fit->num_inliers))));
      }
      result.measured_from_world = fit->target_from_source;
      result.used = fit->inliers;
      return result;
    }
    tried_m *= kStep;
    if (tried_m > kMaxLoosening * accuracy_m ||
        spread(0) < kMinSpread * tried_m) {
      return first_failure;
    }
  }
}

}  // namespace groundlock::map::internal
