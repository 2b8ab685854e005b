// SPDX-License-Identifier: Apache-2.0
// Random sample consensus (RANSAC): small samples of the data propose models,
// and the one that the data agree with best wins, however many of them are
// wrong.
// Source: Fischler & Bolles 1981.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_RANSAC_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_RANSAC_H_

#include <algorithm>
#include <cmath>
#include <optional>
#include <random>

namespace groundlock::geometry {

template <typename Model, typename Support>
struct RansacResult {
  struct Best {
    Model model;
    Support support;  // how the data agree with it
  };
  std::optional<Best> best;  // unset: no sample proposed anything
  int num_samples = 0;
};

// So many samples of `sample_size` make it likely (`confidence`) that one was
// free of outliers, where `inlier_share` of the data are none; in [1, most].
inline int NumSamplesFor(double inlier_share,
                         int sample_size,
                         double confidence,
                         int most) {
  double clean = 1.0;
  for (int i = 0; i < sample_size; ++i) clean *= inlier_share;
  if (clean >= 1.0) return 1;
  const double needed = std::log1p(-confidence) / std::log1p(-clean);
  return static_cast<int>(std::clamp(std::ceil(needed), 1.0, 1.0 * most));
}

// Draws `most` samples, or fewer where the problem says how many it needs.
//
// A Problem has
//   using Model, using Support;
//   void Sample(std::mt19937_64& engine, Consider consider)
//     draws one sample and calls consider(model) for each model that it allows,
//     if any;
//   std::optional<Support> SupportOf(const Model& model, const Support* best)
//     nullopt unless it is better than `best` (null: there is none yet), so
//     that it may be told early that it is not;
// and, if it can be known,
//   int NumSamples(const Support& best)
//     how many samples suffice now that this one was found.
// Deterministic by the engine.
template <typename Problem>
RansacResult<typename Problem::Model, typename Problem::Support> Ransac(
    Problem& problem, int most, std::mt19937_64& engine) {
  using Result =
      RansacResult<typename Problem::Model, typename Problem::Support>;
  Result result;
  int needed = most;
  const auto consider = [&](const typename Problem::Model& model) {
    const auto support =
        problem.SupportOf(model, result.best ? &result.best->support : nullptr);
    if (!support) return;
    result.best = typename Result::Best{model, *support};
    if constexpr (requires { problem.NumSamples(*support); }) {
      needed = std::min(most, problem.NumSamples(*support));
    }
  };
  while (result.num_samples < needed) {
    ++result.num_samples;
    problem.Sample(engine, consider);
  }
  return result;
}

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_RANSAC_H_
