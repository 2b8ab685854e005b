// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include "map_store/base/processor.h"
#include "map_store/features/internal/nearest_two.h"

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace groundlock::features::internal {
namespace {

constexpr std::size_t kLanes = InterleavedDescriptors::kLanes;
constexpr std::size_t kSteps = InterleavedDescriptors::kSteps;
// Queries that share the loads of a group: their sums stay in registers.
#if defined(__aarch64__)
[[maybe_unused]] constexpr std::size_t kQueries = 4;
// Both factors are unsigned.
constexpr std::int32_t kQueryOffset = 0;
#else
[[maybe_unused]] constexpr std::size_t kQueries = 8;
// The instruction wants one factor signed: queries are less by this.
constexpr std::int32_t kQueryOffset = 128;
#endif
[[maybe_unused]] constexpr std::size_t kStepsPerTurn = 8;
// Above every squared distance, far below overflow.
constexpr std::int32_t kNowhere = 1 << 30;

#if defined(__x86_64__) || defined(__aarch64__)

// Queries less kQueryOffset: step k of query j at [k][j].
using QueryBlock = std::array<std::array<std::int32_t, kQueries>, kSteps>;

QueryBlock LoadQueries(const InterleavedDescriptors& queries,
                       std::size_t first) {
  constexpr std::uint32_t kFlip = kQueryOffset * 0x01010101U;
  QueryBlock block{};
  for (std::size_t j = 0; j < kQueries && first + j < queries.size(); ++j) {
    const std::size_t index = first + j;
    const std::uint8_t* bytes =
        queries.group(index / kLanes) + (index % kLanes) * 4;
    for (std::size_t k = 0; k < kSteps; ++k) {
      std::uint32_t four = 0;
      std::memcpy(&four, bytes + k * kLanes * 4, sizeof(four));
      block[k][j] = static_cast<std::int32_t>(four ^ kFlip);
    }
  }
  return block;
}

#endif

#if defined(__x86_64__)

// Distances less the query's squared length, which orders them alike.
[[gnu::target("avx512f,avx512bw,avx512vnni")]] void ScanGroups(
    const QueryBlock& queries,
    const InterleavedDescriptors& references,
    std::array<NearestTwo, kQueries>& nearest) {
  for (std::size_t g = 0; g < references.num_groups(); ++g) {
    const std::uint8_t* bytes = references.group(g);
    __m512i sums[kQueries];
    for (__m512i& sum : sums) sum = _mm512_setzero_si512();
    // Several steps a turn: GCC copies all sums once a turn.
    for (std::size_t turn = 0; turn < kSteps; turn += kStepsPerTurn) {
      for (std::size_t k = turn; k < turn + kStepsPerTurn; ++k) {
        const __m512i lanes = _mm512_loadu_si512(bytes + k * kLanes * 4);
        for (std::size_t j = 0; j < kQueries; ++j) {
          sums[j] = _mm512_dpbusd_epi32(
              sums[j], lanes, _mm512_set1_epi32(queries[k][j]));
        }
      }
    }
    const __m512i biases = _mm512_loadu_si512(references.biases(g));
    for (std::size_t j = 0; j < kQueries; ++j) {
      const __m512i distances =
          _mm512_sub_epi32(biases, _mm512_slli_epi32(sums[j], 1));
      unsigned nearer = _mm512_cmplt_epi32_mask(
          distances, _mm512_set1_epi32(nearest[j].second));
      if (nearer == 0) continue;
      std::array<std::int32_t, kLanes> values;
      _mm512_storeu_si512(values.data(), distances);
      for (; nearer != 0; nearer &= nearer - 1) {
        const auto lane = static_cast<std::size_t>(std::countr_zero(nearer));
        nearest[j].Offer(values[lane],
                         static_cast<std::uint32_t>(g * kLanes + lane));
      }
    }
  }
}

#elif defined(__aarch64__)

[[gnu::target("arch=armv8.2-a+dotprod")]] void ScanGroups(
    const QueryBlock& queries,
    const InterleavedDescriptors& references,
    std::array<NearestTwo, kQueries>& nearest) {
  constexpr std::size_t kParts = kLanes / 4;
  for (std::size_t g = 0; g < references.num_groups(); ++g) {
    const std::uint8_t* bytes = references.group(g);
    uint32x4_t sums[kQueries][kParts];
    for (auto& query : sums) {
      for (uint32x4_t& sum : query) sum = vdupq_n_u32(0);
    }
    for (std::size_t k = 0; k < kSteps; ++k) {
      uint8x16_t lanes[kParts];
      for (std::size_t i = 0; i < kParts; ++i) {
        lanes[i] = vld1q_u8(bytes + (k * kParts + i) * 16);
      }
      for (std::size_t j = 0; j < kQueries; ++j) {
        const uint8x16_t query =
            vreinterpretq_u8_s32(vdupq_n_s32(queries[k][j]));
        for (std::size_t i = 0; i < kParts; ++i) {
          sums[j][i] = vdotq_u32(sums[j][i], lanes[i], query);
        }
      }
    }
    for (std::size_t j = 0; j < kQueries; ++j) {
      for (std::size_t i = 0; i < kParts; ++i) {
        const int32x4_t distances =
            vsubq_s32(vld1q_s32(references.biases(g) + 4 * i),
                      vshlq_n_s32(vreinterpretq_s32_u32(sums[j][i]), 1));
        if (vminvq_s32(distances) >= nearest[j].second) continue;
        std::array<std::int32_t, 4> values;
        vst1q_s32(values.data(), distances);
        for (std::size_t lane = 0; lane < values.size(); ++lane) {
          nearest[j].Offer(
              values[lane],
              static_cast<std::uint32_t>(g * kLanes + 4 * i + lane));
        }
      }
    }
  }
}

#endif

}  // namespace

bool InterleavedDescriptors::IsSupported() {
  return base::MayUseByteProducts();
}

InterleavedDescriptors::InterleavedDescriptors(
    std::span<const map::Descriptor> descriptors) {
  const std::size_t groups = (descriptors.size() + kLanes - 1) / kLanes;
  bytes_.resize(groups * kSteps * kLanes * 4);
  biases_.assign(groups * kLanes, kNowhere);
  squared_lengths_.reserve(descriptors.size());
  for (std::size_t i = 0; i < descriptors.size(); ++i) {
    std::int32_t squared_length = 0;
    std::int32_t sum = 0;
    for (const std::uint8_t value : descriptors[i]) {
      squared_length += std::int32_t{value} * value;
      sum += value;
    }
    squared_lengths_.push_back(squared_length);
    biases_[i] = squared_length - 2 * kQueryOffset * sum;
    std::uint8_t* bytes =
        bytes_.data() + (i / kLanes) * kSteps * kLanes * 4 + (i % kLanes) * 4;
    for (std::size_t k = 0; k < kSteps; ++k) {
      std::memcpy(bytes + k * kLanes * 4, descriptors[i].data() + 4 * k, 4);
    }
  }
}

void InterleavedDescriptors::Find(
    [[maybe_unused]] const InterleavedDescriptors& queries,
    [[maybe_unused]] const InterleavedDescriptors& references,
    [[maybe_unused]] std::span<NearestTwo> nearest) {
#if defined(__x86_64__) || defined(__aarch64__)
  for (std::size_t first = 0; first < queries.size(); first += kQueries) {
    std::array<NearestTwo, kQueries> found;
    ScanGroups(LoadQueries(queries, first), references, found);
    const std::size_t count = std::min(kQueries, queries.size() - first);
    for (std::size_t j = 0; j < count; ++j) {
      const std::int32_t squared_length = queries.squared_length(first + j);
      found[j].first += squared_length;
      found[j].second += squared_length;
      nearest[first + j] = found[j];
    }
  }
#endif
}

}  // namespace groundlock::features::internal
