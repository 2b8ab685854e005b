// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/landmark_index.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/parallel_for.h"
#include "map_store/map/internal/descriptor_distance.h"

namespace groundlock::map {
namespace {

// A leaf list holds about this many entries, so a query that looks into 16 of
// them compares about a thousand descriptors.
constexpr double kEntriesPerList = 64.0;
constexpr std::uint32_t kMinBranching = 4;
constexpr std::uint32_t kMaxBranching = 256;
constexpr int kKMeansRounds = 4;
constexpr std::size_t kMaxTrainingPerWord = 24;
// Two descriptors of one landmark nearer than this (of 512^2 for opposite
// descriptors) find the same queries: one of them is enough.
constexpr int kDistinctSquaredDistance = 150 * 150;
// Entries that a thread takes at a time.
constexpr std::size_t kEntriesPerRange = 4'096;
// Inner words whose leaves compete for a query.
constexpr int kInnerProbes = 4;

using Centroid = std::array<float, 128>;

Descriptor ToDescriptor(const Centroid& centroid) {
  Descriptor descriptor;
  for (int i = 0; i < 128; ++i) {
    descriptor[i] = static_cast<std::uint8_t>(
        std::clamp(std::lround(centroid[i]), 0L, 255L));
  }
  return descriptor;
}

// Up to `count` of `all`; with repetitions if there are more.
std::vector<const Descriptor*> Sample(std::span<const Descriptor* const> all,
                                      std::size_t count,
                                      std::uint64_t seed) {
  std::vector<const Descriptor*> sample(
      all.begin(), all.begin() + std::min(all.size(), count));
  std::mt19937_64 generator(seed);
  if (all.size() > count) {
    for (const Descriptor*& drawn : sample) {
      drawn = all[generator() % all.size()];
    }
  } else {
    std::shuffle(sample.begin(), sample.end(), generator);
  }
  return sample;
}

// Lloyd's k-means on a sample. Words without members keep their place.
std::vector<Descriptor> TrainWords(std::span<const Descriptor* const> all,
                                   std::uint32_t num_words,
                                   std::uint64_t seed) {
  const std::vector<const Descriptor*> sample =
      Sample(all, kMaxTrainingPerWord * num_words, seed);
  std::vector<Descriptor> words(num_words);
  for (std::uint32_t i = 0; i < num_words; ++i) {
    if (!sample.empty()) words[i] = *sample[i % sample.size()];
  }
  std::vector<Centroid> sums(num_words);
  std::vector<int> counts(num_words);
  for (int round = 0; round < kKMeansRounds; ++round) {
    for (Centroid& sum : sums) sum.fill(0.0F);
    std::fill(counts.begin(), counts.end(), 0);
    for (const Descriptor* descriptor : sample) {
      const std::uint32_t word = internal::NearestOf(words, *descriptor);
      ++counts[word];
      for (int i = 0; i < 128; ++i) sums[word][i] += (*descriptor)[i];
    }
    for (std::uint32_t i = 0; i < num_words; ++i) {
      if (counts[i] == 0) continue;
      for (float& value : sums[i]) value /= static_cast<float>(counts[i]);
      words[i] = ToDescriptor(sums[i]);
    }
  }
  return words;
}

struct Entries {
  std::vector<std::uint32_t> landmarks;
  std::vector<const Descriptor*> descriptors;
};

// Up to kMaxDescriptorsPerLandmark descriptors of each landmark, each the one
// farthest from those chosen before (greedy k-centre).
Entries ChooseDescriptors(const MapData& map, int min_views) {
  std::vector<std::uint64_t> begin(map.landmarks.size() + 1, 0);
  for (const MapViewData& view : map.views) {
    for (const std::uint32_t landmark : view.landmarks) ++begin[landmark + 1];
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<const Descriptor*> observed(begin.back());
  std::vector<std::uint64_t> next(begin.begin(), begin.end() - 1);
  for (const MapViewData& view : map.views) {
    for (std::size_t i = 0; i < view.descriptors.size(); ++i) {
      observed[next[view.landmarks[i]]++] = &view.descriptors[i];
    }
  }

  Entries entries;
  for (std::uint32_t landmark = 0; landmark < map.landmarks.size();
       ++landmark) {
    const std::span<const Descriptor* const> candidates(
        observed.data() + begin[landmark], next[landmark] - begin[landmark]);
    if (static_cast<int>(candidates.size()) < min_views) continue;
    std::vector<int> nearest_chosen(candidates.size(),
                                    std::numeric_limits<int>::max());
    std::size_t chosen = 0;
    for (int n = 0; n < kMaxDescriptorsPerLandmark; ++n) {
      entries.landmarks.push_back(landmark);
      entries.descriptors.push_back(candidates[chosen]);
      for (std::size_t i = 0; i < candidates.size(); ++i) {
        nearest_chosen[i] =
            std::min(nearest_chosen[i],
                     SquaredDistance(*candidates[i], *candidates[chosen]));
      }
      chosen = static_cast<std::size_t>(
          std::max_element(nearest_chosen.begin(), nearest_chosen.end()) -
          nearest_chosen.begin());
      if (nearest_chosen[chosen] < kDistinctSquaredDistance) break;
    }
  }
  return entries;
}

}  // namespace

LandmarkIndex ViewOf(const LandmarkIndexData& data) {
  return {data.branching,
          data.inner_words,
          data.leaf_words,
          data.list_begin,
          data.entry_landmarks,
          data.entry_descriptors};
}

bool HasConsistentSizes(const LandmarkIndex& index) {
  if (index.branching > kMaxBranching ||
      index.inner_words.size() != index.branching ||
      index.entry_landmarks.size() != index.entry_descriptors.size()) {
    return false;
  }
  const std::size_t num_lists =
      static_cast<std::size_t>(index.branching) * index.branching;
  if (index.leaf_words.size() != num_lists) return false;
  return index.empty() ? index.list_begin.empty()
                       : index.list_begin.size() == num_lists + 1;
}

absl::Status VerifyIndex(const LandmarkIndex& index,
                         std::size_t num_landmarks) {
  if (index.empty()) return absl::OkStatus();
  if (!std::is_sorted(index.list_begin.begin(), index.list_begin.end()) ||
      index.list_begin.front() != 0 ||
      index.list_begin.back() != index.entry_landmarks.size()) {
    return absl::DataLossError(
        "section 'index list begin': lists do not follow each other");
  }
  for (const std::uint32_t landmark : index.entry_landmarks) {
    if (landmark >= num_landmarks) {
      return absl::DataLossError(
          "section 'index landmarks': an entry names no landmark");
    }
  }
  return absl::OkStatus();
}

LandmarkIndexData BuildLandmarkIndex(const MapData& map, int min_views) {
  LandmarkIndexData index;
  const Entries entries = ChooseDescriptors(map, std::max(min_views, 1));
  const std::size_t num_entries = entries.landmarks.size();
  if (num_entries == 0) return index;

  const std::uint32_t branching = std::clamp(
      static_cast<std::uint32_t>(std::lround(
          std::sqrt(static_cast<double>(num_entries) / kEntriesPerList))),
      kMinBranching,
      kMaxBranching);
  index.branching = branching;
  index.inner_words = TrainWords(entries.descriptors, branching, 1);

  std::vector<std::uint32_t> inner_of(num_entries);
  base::ParallelFor(
      num_entries, kEntriesPerRange, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
          inner_of[i] =
              internal::NearestOf(index.inner_words, *entries.descriptors[i]);
        }
      });
  std::vector<std::vector<const Descriptor*>> members(branching);
  for (std::size_t i = 0; i < num_entries; ++i) {
    members[inner_of[i]].push_back(entries.descriptors[i]);
  }
  index.leaf_words.resize(static_cast<std::size_t>(branching) * branching);
  base::ParallelFor(branching, 1, [&](std::size_t inner, std::size_t) {
    const std::vector<Descriptor> leaves =
        TrainWords(members[inner], branching, base::MixSeed(1, inner));
    std::copy(leaves.begin(),
              leaves.end(),
              index.leaf_words.begin() +
                  static_cast<std::ptrdiff_t>(inner * branching));
  });

  const std::size_t num_lists = index.leaf_words.size();
  std::vector<std::uint32_t> list_of(num_entries);
  base::ParallelFor(
      num_entries, kEntriesPerRange, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
          const std::uint32_t first = inner_of[i] * branching;
          list_of[i] =
              first + internal::NearestOf(
                          std::span(index.leaf_words).subspan(first, branching),
                          *entries.descriptors[i]);
        }
      });
  index.list_begin.assign(num_lists + 1, 0);
  for (const std::uint32_t list : list_of) ++index.list_begin[list + 1];
  std::partial_sum(index.list_begin.begin(),
                   index.list_begin.end(),
                   index.list_begin.begin());
  std::vector<std::uint64_t> next(index.list_begin.begin(),
                                  index.list_begin.end() - 1);
  index.entry_landmarks.resize(num_entries);
  index.entry_descriptors.resize(num_entries);
  for (std::size_t i = 0; i < num_entries; ++i) {
    const std::uint64_t slot = next[list_of[i]]++;
    index.entry_landmarks[slot] = entries.landmarks[i];
    index.entry_descriptors[slot] = *entries.descriptors[i];
  }
  return index;
}

IndexMatch FindLandmark(const LandmarkIndex& index,
                        const Descriptor& descriptor,
                        int num_lists) {
  IndexMatch match;
  if (index.empty()) return match;
  using Scored = std::pair<int, std::uint32_t>;  // distance, word

  std::array<std::int32_t, kMaxBranching> distances;
  internal::SquaredDistances(descriptor, index.inner_words, distances.data());
  std::array<Scored, kMaxBranching> inner;
  for (std::uint32_t i = 0; i < index.branching; ++i) {
    inner[i] = {distances[i], i};
  }
  const int inner_probes =
      std::min<int>(kInnerProbes, static_cast<int>(index.branching));
  std::partial_sort(inner.begin(),
                    inner.begin() + inner_probes,
                    inner.begin() + index.branching);

  std::array<Scored, kInnerProbes * kMaxBranching> leaves;
  int num_leaves = 0;
  for (int i = 0; i < inner_probes; ++i) {
    const std::uint32_t first = inner[i].second * index.branching;
    internal::SquaredDistances(descriptor,
                               index.leaf_words.subspan(first, index.branching),
                               distances.data());
    for (std::uint32_t j = 0; j < index.branching; ++j) {
      const std::uint32_t leaf = first + j;
      if (index.list_begin[leaf] == index.list_begin[leaf + 1]) continue;
      leaves[num_leaves++] = {distances[j], leaf};
    }
  }
  const int leaf_probes = std::min(num_lists, num_leaves);
  std::partial_sort(leaves.begin(),
                    leaves.begin() + leaf_probes,
                    leaves.begin() + num_leaves);

  for (int i = 0; i < leaf_probes; ++i) {
    const std::uint32_t leaf = leaves[i].second;
    // A damaged file must not lead outside (Map::Open does not read lists).
    const std::uint64_t end = std::min<std::uint64_t>(
        index.list_begin[leaf + 1], index.entry_landmarks.size());
    for (std::uint64_t begin = index.list_begin[leaf]; begin < end;
         begin += distances.size()) {
      const std::size_t count =
          std::min<std::uint64_t>(distances.size(), end - begin);
      internal::SquaredDistances(descriptor,
                                 index.entry_descriptors.subspan(begin, count),
                                 distances.data());
      for (std::size_t j = 0; j < count; ++j) {
        const std::uint32_t landmark = index.entry_landmarks[begin + j];
        if (landmark >= index.num_landmarks) continue;
        match.Offer(landmark, distances[j]);
      }
    }
  }
  return match;
}

}  // namespace groundlock::map
