// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "map_store/base/processor.h"
#include "map_store/features/internal/nearest_two.h"

namespace groundlock::features::internal {
namespace {

constexpr std::size_t kDimensions = 128;
// References that are compared with all queries before the next are: 64 x 256
// bytes stay in the first-level cache.
constexpr std::size_t kBlock = 64;
// Dot products that share the loads of one query.
constexpr std::size_t kRowsAtOnce = 4;

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
    const WideDescriptors& queries,
    const WideDescriptors& references,
    std::size_t begin,
    std::size_t end,
    std::span<NearestTwo> nearest) {
  for (std::size_t q = 0; q < queries.size(); ++q) {
    const std::int16_t* query = queries.values(q);
    const std::int32_t squared_length = queries.squared_length(q);
    NearestTwo best = nearest[q];
    std::size_t r = begin;
    for (; r + kRowsAtOnce <= end; r += kRowsAtOnce) {
      std::int32_t dots[kRowsAtOnce];
      DotProducts(query, references.values(r), dots);
      for (std::size_t lane = 0; lane < kRowsAtOnce; ++lane) {
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

using ScanBlock = void (*)(const WideDescriptors&,
                           const WideDescriptors&,
                           std::size_t,
                           std::size_t,
                           std::span<NearestTwo>);

void ScanBlockPortable(const WideDescriptors& queries,
                       const WideDescriptors& references,
                       std::size_t begin,
                       std::size_t end,
                       std::span<NearestTwo> nearest) {
  ScanBlockInline(queries, references, begin, end, nearest);
}

#if defined(__x86_64__)
// The same code with wider registers, chosen at run time: integers give the
// same result either way.
[[gnu::target("avx2")]] void ScanBlockAvx2(const WideDescriptors& queries,
                                           const WideDescriptors& references,
                                           std::size_t begin,
                                           std::size_t end,
                                           std::span<NearestTwo> nearest) {
  ScanBlockInline(queries, references, begin, end, nearest);
}

ScanBlock ChooseScanBlock() {
  return base::MayUseAvx2() ? ScanBlockAvx2 : ScanBlockPortable;
}
#else
ScanBlock ChooseScanBlock() { return ScanBlockPortable; }
#endif

}  // namespace

WideDescriptors::WideDescriptors(std::span<const map::Descriptor> descriptors) {
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

void WideDescriptors::Find(const WideDescriptors& queries,
                           const WideDescriptors& references,
                           std::span<NearestTwo> nearest) {
  static const ScanBlock scan_block = ChooseScanBlock();
  for (std::size_t begin = 0; begin < references.size(); begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, references.size());
    scan_block(queries, references, begin, end, nearest);
  }
}

}  // namespace groundlock::features::internal
