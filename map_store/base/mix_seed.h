// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_BASE_MIX_SEED_H_
#define GROUNDLOCK_MAP_STORE_BASE_MIX_SEED_H_

#include <cstdint>

namespace groundlock::base {

// Combines two seeds into one, so that each frame of each session draws from
// a generator of its own and scheduling cannot change results.
// Source: the finaliser of SplitMix64 (Steele, Lea & Flood 2014, figure 15).
constexpr std::uint64_t MixSeed(std::uint64_t a, std::uint64_t b) {
  std::uint64_t z = a + 0x9E3779B97F4A7C15ULL * (b + 1);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return z ^ (z >> 31);
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_MIX_SEED_H_
