// SPDX-License-Identifier: Apache-2.0
// Which images to match: neighbours in time, and those that look alike.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_PAIRS_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_PAIRS_H_

#include <Eigen/Core>
#include <compare>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

struct ImagePair {
  std::uint32_t first = 0;  // first < second
  std::uint32_t second = 0;
  friend auto operator<=>(const ImagePair&, const ImagePair&) = default;
};

struct PairOptions {
  // Up to this many images, every pair is taken.
  std::size_t exhaustive_up_to = 30;
  // Neighbours in the sequence, then those 16, 32, 64, ... behind.
  std::size_t overlap = 6;
  // Images that look most alike, which closes loops: per image.
  std::size_t similar = 8;
  std::uint64_t seed = 0;
};

// One unit vector per image; their dot products tell how much two images look
// alike. Deterministic.
//   descriptors  per image
// Source: Jegou et al. 2010 (vectors of locally aggregated descriptors), with
// the normalisation of Arandjelovic & Zisserman 2013 (per word).
std::vector<Eigen::VectorXf> DescribeImages(
    std::span<const std::span<const map::Descriptor>> descriptors,
    std::uint64_t seed);

// Sorted, without duplicates.
std::vector<ImagePair> ChoosePairs(
    std::span<const std::span<const map::Descriptor>> descriptors,
    const PairOptions& options);

struct PairMatches {
  ImagePair pair;
  std::vector<std::array<std::uint32_t, 2>> features;
};

// Features that are each other's nearest and pass the ratio test in the first
// direction. Pairs with fewer than min_matches come out without any.
absl::StatusOr<std::vector<PairMatches>> MatchPairs(
    std::span<const std::span<const map::Descriptor>> descriptors,
    std::span<const ImagePair> pairs,
    double ratio,
    std::size_t min_matches,
    int threads,
    const std::function<bool(std::size_t)>& progress);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_PAIRS_H_
