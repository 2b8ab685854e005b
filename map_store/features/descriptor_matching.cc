// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/descriptor_matching.h"

#include <algorithm>
#include <limits>

namespace groundlock::features {
namespace {

constexpr std::size_t kDimensions = DescriptorSet::kDimensions;
// References that are compared with all queries before the next are: 64 x 256
// bytes stay in the first-level cache.
constexpr std::size_t kBlock = 64;
// Dot products that share the loads of one query.
constexpr std::size_t kLanes = 4;

struct Nearest {
  std::int32_t first = std::numeric_limits<std::int32_t>::max();
  std::int32_t second = std::numeric_limits<std::int32_t>::max();
  std::uint32_t reference = 0;

  void Offer(std::int32_t squared_distance, std::uint32_t index) {
    if (squared_distance < first) {
      second = first;
      first = squared_distance;
      reference = index;
    } else if (squared_distance < second) {
      second = squared_distance;
    }
  }
};

// Compilers turn this loop into multiply-add instructions on 16-bit lanes;
// sums stay below 128 * 255^2 < 2^23.
[[gnu::always_inline]] inline void DotProducts(const std::int16_t* query,
                                               const std::int16_t* references,
                                               std::int32_t* dots) {
  std::int32_t dot0 = 0;
  std::int32_t dot1 = 0;
  std::int32_t dot2 = 0;
  std::int32_t dot3 = 0;
  for (std::size_t d = 0; d < kDimensions; ++d) {
    const std::int32_t value = query[d];
    dot0 += value * references[d];
    dot1 += value * references[d + kDimensions];
    dot2 += value * references[d + 2 * kDimensions];
    dot3 += value * references[d + 3 * kDimensions];
  }
  dots[0] = dot0;
  dots[1] = dot1;
  dots[2] = dot2;
  dots[3] = dot3;
}

[[gnu::always_inline]] inline std::int32_t DotProduct(const std::int16_t* a,
                                                      const std::int16_t* b) {
  std::int32_t dot = 0;
  for (std::size_t d = 0; d < kDimensions; ++d)
    dot += std::int32_t{a[d]} * b[d];
  return dot;
}

// Offers references [begin, end) to every query.
[[gnu::always_inline]] inline void ScanBlockInline(
    const DescriptorSet& queries,
    const DescriptorSet& references,
    std::size_t begin,
    std::size_t end,
    std::span<Nearest> nearest) {
  for (std::size_t q = 0; q < queries.size(); ++q) {
    const std::int16_t* query = queries.values(q);
    const std::int32_t squared_length = queries.squared_length(q);
    Nearest best = nearest[q];
    std::size_t r = begin;
    for (; r + kLanes <= end; r += kLanes) {
      std::int32_t dots[kLanes];
      DotProducts(query, references.values(r), dots);
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        best.Offer(squared_length + references.squared_length(r + lane) -
                       2 * dots[lane],
                   static_cast<std::uint32_t>(r + lane));
      }
    }
    for (; r < end; ++r) {
      best.Offer(squared_length + references.squared_length(r) -
                     2 * DotProduct(query, references.values(r)),
                 static_cast<std::uint32_t>(r));
    }
    nearest[q] = best;
  }
}

using ScanBlock = void (*)(const DescriptorSet&,
                           const DescriptorSet&,
                           std::size_t,
                           std::size_t,
                           std::span<Nearest>);

void ScanBlockPortable(const DescriptorSet& queries,
                       const DescriptorSet& references,
                       std::size_t begin,
                       std::size_t end,
                       std::span<Nearest> nearest) {
  ScanBlockInline(queries, references, begin, end, nearest);
}

#if defined(__x86_64__)
// The same code with wider registers, chosen at run time: integers give the
// same result either way.
[[gnu::target("avx2")]] void ScanBlockAvx2(const DescriptorSet& queries,
                                           const DescriptorSet& references,
                                           std::size_t begin,
                                           std::size_t end,
                                           std::span<Nearest> nearest) {
  ScanBlockInline(queries, references, begin, end, nearest);
}

ScanBlock ChooseScanBlock() {
  return __builtin_cpu_supports("avx2") ? ScanBlockAvx2 : ScanBlockPortable;
}
#else
ScanBlock ChooseScanBlock() { return ScanBlockPortable; }
#endif

}  // namespace

DescriptorSet::DescriptorSet(std::span<const map::Descriptor> descriptors) {
  values_.reserve(descriptors.size() * kDimensions);
  squared_lengths_.reserve(descriptors.size());
  for (const map::Descriptor& descriptor : descriptors) {
    std::int32_t squared_length = 0;
    for (const std::uint8_t value : descriptor) {
      values_.push_back(value);
      squared_length += std::int32_t{value} * value;
    }
    squared_lengths_.push_back(squared_length);
  }
}

std::vector<DescriptorMatch> MatchDescriptors(const DescriptorSet& queries,
                                              const DescriptorSet& references,
                                              double ratio) {
  std::vector<DescriptorMatch> matches;
  if (references.size() < 2) return matches;
  std::vector<Nearest> nearest(queries.size());
  const ScanBlock scan_block = ChooseScanBlock();
  for (std::size_t begin = 0; begin < references.size(); begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, references.size());
    scan_block(queries, references, begin, end, nearest);
  }
  const double squared_ratio = ratio * ratio;
  for (std::size_t q = 0; q < nearest.size(); ++q) {
    const Nearest& best = nearest[q];
    // Two references equal to the query (0 / 0) are ambiguous.
    if (best.second > 0 && best.first <= squared_ratio * best.second) {
      matches.push_back({.query = static_cast<std::uint32_t>(q),
                         .reference = best.reference,
                         .squared_distance = best.first});
    }
  }
  return matches;
}

}  // namespace groundlock::features
