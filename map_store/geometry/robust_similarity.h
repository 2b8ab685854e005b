// SPDX-License-Identifier: Apache-2.0
// Similarities from paired points of which some are wrong.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_ROBUST_SIMILARITY_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_ROBUST_SIMILARITY_H_

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::geometry {

struct RobustSimilarityOptions {
  // 1 sigma per axis of a good target point, target's unit; > 0. Pairs whose
  // error stays below 2.8 of it (95 % of a 3D Gaussian) are inliers.
  double sigma = 1.0;
  // Both frames have z up: the rotation is about z alone. Two points that are
  // not above each other are then enough, and points on a line determine it.
  bool upright = false;
  int rounds = 1'000;
  std::uint64_t seed = 0;
};

struct RobustSimilarity {
  Similarity3 target_from_source;
  std::vector<bool> inliers;  // per pair
  int num_inliers = 0;
};

// The similarity that most pairs agree on: random samples of three (two), then
// least squares over the inliers with Huber's weights, until they settle.
// kInvalidArgument on sizes, numbers that are not finite; kFailedPrecondition
// if the points do not determine it or fewer than half of the pairs agree.
// Deterministic.
// Source: Fischler & Bolles 1981; Umeyama 1991; Huber 1964 (k = 1.345).
absl::StatusOr<RobustSimilarity> EstimateSimilarityRobustly(
    std::span<const Eigen::Vector3d> p_source,
    std::span<const Eigen::Vector3d> p_target,
    const RobustSimilarityOptions& options);

// How far points spread, as standard deviations along their principal axes,
// largest first.
Eigen::Vector3d PrincipalSpread(std::span<const Eigen::Vector3d> points);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_ROBUST_SIMILARITY_H_
