// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/descriptor_distance.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>

#include "map_store/base/processor.h"

namespace groundlock::map::internal {
namespace {

// Compilers turn the inner loop into multiply-add instructions on 16-bit lanes.
[[gnu::always_inline]] inline void SquaredDistancesInline(
    const std::uint8_t* query,
    const Descriptor* references,
    std::size_t count,
    std::int32_t* distances) {
  for (std::size_t r = 0; r < count; ++r) {
    const std::uint8_t* reference = references[r].data();
    std::int32_t sum = 0;
    for (int i = 0; i < 128; ++i) {
      const auto difference =
          static_cast<std::int16_t>(query[i] - reference[i]);
      sum += std::int32_t{difference} * difference;
    }
    distances[r] = sum;
  }
}

using Function = void (*)(const std::uint8_t*,
                          const Descriptor*,
                          std::size_t,
                          std::int32_t*);

void SquaredDistancesPortable(const std::uint8_t* query,
                              const Descriptor* references,
                              std::size_t count,
                              std::int32_t* distances) {
  SquaredDistancesInline(query, references, count, distances);
}

#if defined(__x86_64__)
// The same code with wider registers, chosen at run time.
[[gnu::target("avx2")]] void SquaredDistancesAvx2(const std::uint8_t* query,
                                                  const Descriptor* references,
                                                  std::size_t count,
                                                  std::int32_t* distances) {
  SquaredDistancesInline(query, references, count, distances);
}

Function Choose() {
  return base::MayUseAvx2() ? SquaredDistancesAvx2 : SquaredDistancesPortable;
}
#else
Function Choose() { return SquaredDistancesPortable; }
#endif

}  // namespace

void SquaredDistances(const Descriptor& query,
                      std::span<const Descriptor> references,
                      std::int32_t* distances) {
  static const Function function = Choose();
  function(query.data(), references.data(), references.size(), distances);
}

std::uint32_t NearestOf(std::span<const Descriptor> references,
                        const Descriptor& query) {
  constexpr std::size_t kBlock = 64;
  std::array<std::int32_t, kBlock> distances;
  std::uint32_t best = 0;
  std::int32_t best_distance = std::numeric_limits<std::int32_t>::max();
  for (std::size_t begin = 0; begin < references.size(); begin += kBlock) {
    const std::size_t count = std::min(kBlock, references.size() - begin);
    SquaredDistances(query, references.subspan(begin, count), distances.data());
    for (std::size_t i = 0; i < count; ++i) {
      if (distances[i] < best_distance) {
        best_distance = distances[i];
        best = static_cast<std::uint32_t>(begin + i);
      }
    }
  }
  return best;
}

}  // namespace groundlock::map::internal
