// SPDX-License-Identifier: Apache-2.0
// The similarity between two maps from landmarks that may be the same.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SIMILARITY_RANSAC_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SIMILARITY_RANSAC_H_

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/similarity3.h"

namespace groundlock::build::internal {

struct PointPair {
  Eigen::Vector3d p_source = Eigen::Vector3d::Zero();
  Eigen::Vector3d p_target = Eigen::Vector3d::Zero();
};

// How far pair `index` is off when its source point is moved to `p_target`:
// any measure, say pixels in a view of the target.
using PairError =
    std::function<double(std::size_t index, const Eigen::Vector3d& p_target)>;

struct SimilarityRansacOptions {
  double max_error = 6.0;  // in PairError's unit
  int min_inliers = 12;
  double confidence = 0.9999;
  int max_iterations = 10'000;
  std::uint64_t seed = 0;
};

struct SimilarityRansacResult {
  geometry::Similarity3 target_from_source;
  std::vector<bool> is_inlier;  // per pair
  int num_inliers = 0;
  int iterations = 0;
};

// Three pairs propose, the largest set of agreeing pairs wins and is fitted
// again and again until it stays. nullopt if fewer than min_inliers agree.
// Deterministic. Source: Fischler & Bolles 1981; Umeyama 1991.
std::optional<SimilarityRansacResult> EstimateSimilarityRansac(
    std::span<const PointPair> pairs,
    const PairError& error,
    const SimilarityRansacOptions& options);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SIMILARITY_RANSAC_H_
