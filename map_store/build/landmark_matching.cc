// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/landmark_matching.h"

#include <map>

namespace groundlock::build::internal {
namespace {

// Leaf lists that are looked into: more find more, ever more slowly.
constexpr int kLists = 8;

}  // namespace

std::vector<std::vector<ObservationId>> ObservationsByLandmark(
    const map::MapData& data) {
  std::vector<std::vector<ObservationId>> observations(data.landmarks.size());
  for (std::uint32_t v = 0; v < data.views.size(); ++v) {
    const auto& landmarks = data.views[v].landmarks;
    for (std::uint32_t f = 0; f < landmarks.size(); ++f) {
      observations[landmarks[f]].push_back({v, f});
    }
  }
  return observations;
}

std::vector<LandmarkMatch> MatchToLandmarks(
    std::span<const map::Descriptor> queries,
    const map::LandmarkIndex& index,
    double ratio) {
  std::map<std::uint32_t, LandmarkMatch> by_landmark;
  const double squared_ratio = ratio * ratio;
  for (std::uint32_t q = 0; q < queries.size(); ++q) {
    const map::IndexMatch found = map::FindLandmark(index, queries[q], kLists);
    if (found.landmark == map::IndexMatch::kNone ||
        found.squared_distance >
            squared_ratio * found.second_squared_distance) {
      continue;
    }
    const LandmarkMatch match{q, found.landmark, found.squared_distance};
    const auto [it, is_new] = by_landmark.emplace(found.landmark, match);
    if (!is_new && match.squared_distance < it->second.squared_distance) {
      it->second = match;
    }
  }
  std::vector<LandmarkMatch> matches;
  for (const auto& [landmark, match] : by_landmark) matches.push_back(match);
  return matches;
}

}  // namespace groundlock::build::internal
