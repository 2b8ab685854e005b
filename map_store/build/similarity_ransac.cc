// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/similarity_ransac.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "map_store/base/mix_seed.h"

namespace groundlock::build::internal {
namespace {

constexpr int kRefits = 10;

std::optional<geometry::Similarity3> Fit(std::span<const PointPair> pairs,
                                         std::span<const std::size_t> chosen) {
  std::vector<Eigen::Vector3d> source;
  std::vector<Eigen::Vector3d> target;
  for (const std::size_t index : chosen) {
    source.push_back(pairs[index].p_source);
    target.push_back(pairs[index].p_target);
  }
  const auto fitted = geometry::EstimateSimilarity(source, target);
  if (!fitted.ok() || !fitted->IsFinite() || !(fitted->scale > 0.0)) {
    return std::nullopt;
  }
  return *fitted;
}

std::vector<std::size_t> Agreeing(std::span<const PointPair> pairs,
                                  const PairError& error,
                                  double max_error,
                                  const geometry::Similarity3& transform) {
  std::vector<std::size_t> agreeing;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (error(i, transform * pairs[i].p_source) <= max_error) {
      agreeing.push_back(i);
    }
  }
  return agreeing;
}

}  // namespace

std::optional<SimilarityRansacResult> EstimateSimilarityRansac(
    std::span<const PointPair> pairs,
    const PairError& error,
    const SimilarityRansacOptions& options) {
  if (pairs.size() < 3) return std::nullopt;
  std::mt19937_64 engine(base::MixSeed(options.seed, pairs.size()));
  SimilarityRansacResult result;
  std::vector<std::size_t> best;
  double needed = options.max_iterations;
  for (; result.iterations < std::min<double>(needed, options.max_iterations);
       ++result.iterations) {
    std::array<std::size_t, 3> sample{};
    for (std::size_t& index : sample) index = engine() % pairs.size();
    if (sample[0] == sample[1] || sample[0] == sample[2] ||
        sample[1] == sample[2]) {
      continue;
    }
    const auto proposed = Fit(pairs, sample);
    if (!proposed) continue;
    std::vector<std::size_t> agreeing =
        Agreeing(pairs, error, options.max_error, *proposed);
    if (agreeing.size() <= best.size()) continue;
    best = std::move(agreeing);
    result.target_from_source = *proposed;
    const double share =
        static_cast<double>(best.size()) / static_cast<double>(pairs.size());
    const double miss = 1.0 - share * share * share;
    needed =
        miss <= 0.0 ? 0.0 : std::log(1.0 - options.confidence) / std::log(miss);
  }
  for (int round = 0; round < kRefits && best.size() >= 3; ++round) {
    const auto fitted = Fit(pairs, best);
    if (!fitted) break;
    std::vector<std::size_t> agreeing =
        Agreeing(pairs, error, options.max_error, *fitted);
    if (agreeing.size() < best.size()) break;
    result.target_from_source = *fitted;
    const bool stays = agreeing == best;
    best = std::move(agreeing);
    if (stays) break;
  }
  if (static_cast<int>(best.size()) < options.min_inliers) return std::nullopt;
  result.is_inlier.resize(pairs.size());
  for (const std::size_t index : best) result.is_inlier[index] = true;
  result.num_inliers = static_cast<int>(best.size());
  return result;
}

}  // namespace groundlock::build::internal
