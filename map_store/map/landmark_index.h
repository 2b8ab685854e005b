// SPDX-License-Identifier: Apache-2.0
// From a descriptor to the landmarks that look like it: an inverted file over a
// two-level vocabulary tree. Built when a map is written and stored in its
// file; a query touches a few lists, whatever the map's size.
#ifndef GROUNDLOCK_MAP_STORE_MAP_LANDMARK_INDEX_H_
#define GROUNDLOCK_MAP_STORE_MAP_LANDMARK_INDEX_H_

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {

// Squared Euclidean distance, in [0, 128 * 255^2].
inline int SquaredDistance(const Descriptor& a, const Descriptor& b) {
  int sum = 0;
  for (int i = 0; i < 128; ++i) {
    const int difference = static_cast<int>(a[i]) - static_cast<int>(b[i]);
    sum += difference * difference;
  }
  return sum;
}

// One (landmark, descriptor) pair; a landmark has up to
// kMaxDescriptorsPerLandmark of them, so that it is found from several sides.
struct LandmarkIndexData {
  // Vocabulary: `branching` inner words, each with `branching` leaf words.
  std::uint32_t branching = 0;  // 0 = no index (a map without descriptors)
  std::vector<Descriptor> inner_words;    // branching
  std::vector<Descriptor> leaf_words;     // branching^2
  std::vector<std::uint64_t> list_begin;  // branching^2 + 1
  std::vector<std::uint32_t> entry_landmarks;
  std::vector<Descriptor> entry_descriptors;
};

// The index as it lies in a map file.
struct LandmarkIndex {
  std::uint32_t branching = 0;
  std::span<const Descriptor> inner_words;
  std::span<const Descriptor> leaf_words;
  std::span<const std::uint64_t> list_begin;
  std::span<const std::uint32_t> entry_landmarks;
  std::span<const Descriptor> entry_descriptors;
  // Entries that name a landmark beyond are left out: nobody has read them.
  std::uint64_t num_landmarks = std::numeric_limits<std::uint64_t>::max();

  bool empty() const { return branching == 0; }
};
LandmarkIndex ViewOf(const LandmarkIndexData& data);

// The arrays fit together: what FindLandmark relies on.
bool HasConsistentSizes(const LandmarkIndex& index);
// Lists ascend and stay inside, entries name landmarks. kDataLoss.
absl::Status VerifyIndex(const LandmarkIndex& index, std::size_t num_landmarks);

inline constexpr int kMaxDescriptorsPerLandmark = 4;

// Deterministic, on all cores. Landmarks seen in fewer than min_views views are
// left out.
LandmarkIndexData BuildLandmarkIndex(const MapData& map, int min_views = 3);

// The two nearest landmarks among the lists that were looked into.
struct IndexMatch {
  static constexpr std::uint32_t kNone =
      std::numeric_limits<std::uint32_t>::max();
  std::uint32_t landmark = kNone;
  int squared_distance = std::numeric_limits<int>::max();
  // Of the nearest entry of any other landmark.
  int second_squared_distance = std::numeric_limits<int>::max();

  void Offer(std::uint32_t candidate, int candidate_squared_distance) {
    if (candidate_squared_distance < squared_distance) {
      if (candidate != landmark) second_squared_distance = squared_distance;
      squared_distance = candidate_squared_distance;
      landmark = candidate;
    } else if (candidate != landmark &&
               candidate_squared_distance < second_squared_distance) {
      second_squared_distance = candidate_squared_distance;
    }
  }
};

// Looks into the `num_lists` leaf lists nearest to the descriptor. Thread-safe.
IndexMatch FindLandmark(const LandmarkIndex& index,
                        const Descriptor& descriptor,
                        int num_lists);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_LANDMARK_INDEX_H_
