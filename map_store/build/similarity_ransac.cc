// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/similarity_ransac.h"

#include <algorithm>
#include <array>
#include <random>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/geometry/ransac.h"

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

// Three pairs propose; those agree whose error is small enough.
struct SimilaritySamples {
  using Model = geometry::Similarity3;
  using Support = std::vector<std::size_t>;

  std::span<const PointPair> pairs;
  const PairError& error;
  const SimilarityRansacOptions& options;

  template <typename Consider>
  void Sample(std::mt19937_64& engine, Consider consider) const {
    std::array<std::size_t, 3> sample{};
    for (std::size_t& index : sample) index = engine() % pairs.size();
    if (sample[0] == sample[1] || sample[0] == sample[2] ||
        sample[1] == sample[2]) {
      return;
    }
    const auto proposed = Fit(pairs, sample);
    if (proposed) consider(*proposed);
  }
  std::optional<Support> SupportOf(const Model& model,
                                   const Support* best) const {
    Support agreeing = Agreeing(pairs, error, options.max_error, model);
    if (best != nullptr && agreeing.size() <= best->size()) return std::nullopt;
    return agreeing;
  }
  int NumSamples(const Support& best) const {
    return geometry::NumSamplesFor(
        static_cast<double>(best.size()) / static_cast<double>(pairs.size()),
        3,
        options.confidence,
        options.max_iterations);
  }
};

}  // namespace

std::optional<SimilarityRansacResult> EstimateSimilarityRansac(
    std::span<const PointPair> pairs,
    const PairError& error,
    const SimilarityRansacOptions& options) {
  if (pairs.size() < 3) return std::nullopt;
  std::mt19937_64 engine(base::MixSeed(options.seed, pairs.size()));
  SimilaritySamples problem{pairs, error, options};
  auto found = geometry::Ransac(problem, options.max_iterations, engine);
  if (!found.best) return std::nullopt;
  SimilarityRansacResult result;
  result.iterations = found.num_samples;
  result.target_from_source = found.best->model;
  std::vector<std::size_t> best = std::move(found.best->support);
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
