// SPDX-License-Identifier: Apache-2.0
// The two nearest references of many queries, by the instructions that the
// processor has. Arithmetic is exact: all give the same.
#ifndef GROUNDLOCK_MAP_STORE_FEATURES_INTERNAL_NEAREST_TWO_H_
#define GROUNDLOCK_MAP_STORE_FEATURES_INTERNAL_NEAREST_TWO_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "map_store/map/map_data.h"

namespace groundlock::features::internal {

// Squared distances; ties go to the lower index.
struct NearestTwo {
  std::int32_t first = std::numeric_limits<std::int32_t>::max();
  std::int32_t second = std::numeric_limits<std::int32_t>::max();
  std::uint32_t reference = 0;  // of `first`

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

// Descriptors one after the other, widened to 16 bits: what compilers turn into
// multiply-add instructions.
class WideDescriptors {
 public:
  WideDescriptors() = default;
  explicit WideDescriptors(std::span<const map::Descriptor> descriptors);
  std::size_t size() const { return squared_lengths_.size(); }

  // `nearest`: one per query.
  static void Find(const WideDescriptors& queries,
                   const WideDescriptors& references,
                   std::span<NearestTwo> nearest);

  const std::int16_t* values(std::size_t index) const {
    return values_.data() + index * 128;
  }
  std::int32_t squared_length(std::size_t index) const {
    return squared_lengths_[index];
  }

 private:
  std::vector<std::int16_t> values_;
  std::vector<std::int32_t> squared_lengths_;
};

// Descriptors of 8 bits in groups of 16 whose bytes are interleaved by fours:
// what AVX-512's VNNI (64 products at a time) and arm64's dot products (16)
// multiply and sum into one distance per lane. With VNNI about six times as
// fast as the wide ones, at half the size.
class InterleavedDescriptors {
 public:
  static constexpr std::size_t kLanes = 16;
  static constexpr std::size_t kSteps = 128 / 4;

  static bool IsSupported();  // by this processor

  InterleavedDescriptors() = default;
  explicit InterleavedDescriptors(std::span<const map::Descriptor> descriptors);
  std::size_t size() const { return squared_lengths_.size(); }

  // `nearest`: one per query. Only if IsSupported().
  static void Find(const InterleavedDescriptors& queries,
                   const InterleavedDescriptors& references,
                   std::span<NearestTwo> nearest);

  // Group g, step k, lane l: bytes 4k to 4k + 3 of descriptor 16g + l.
  const std::uint8_t* group(std::size_t g) const {
    return bytes_.data() + g * kSteps * kLanes * 4;
  }
  std::size_t num_groups() const { return biases_.size() / kLanes; }
  // What a lane's distance has besides products with the query less an offset o
  // that the instructions ask for: |r|^2 - 2 o sum(r); of lanes beyond the
  // last, more than any distance.
  const std::int32_t* biases(std::size_t g) const {
    return biases_.data() + g * kLanes;
  }
  std::int32_t squared_length(std::size_t index) const {
    return squared_lengths_[index];
  }

 private:
  std::vector<std::uint8_t> bytes_;
  std::vector<std::int32_t> biases_;
  std::vector<std::int32_t> squared_lengths_;
};

}  // namespace groundlock::features::internal

#endif  // GROUNDLOCK_MAP_STORE_FEATURES_INTERNAL_NEAREST_TWO_H_
