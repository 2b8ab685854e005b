// SPDX-License-Identifier: Apache-2.0
// Exhaustive two-nearest-neighbour matching of 8-bit SIFT descriptors.
#ifndef GROUNDLOCK_MAP_STORE_FEATURES_DESCRIPTOR_MATCHING_H_
#define GROUNDLOCK_MAP_STORE_FEATURES_DESCRIPTOR_MATCHING_H_

#include <cstdint>
#include <span>
#include <variant>
#include <vector>

#include "map_store/features/internal/nearest_two.h"
#include "map_store/map/map_data.h"

namespace groundlock::features {

// The same result either way.
enum class Arithmetic { kFastest, kPortable };

struct DescriptorMatch;

// Descriptors in the form in which this processor compares them fastest.
// Immutable; thread-safe.
class DescriptorSet {
 public:
  DescriptorSet() = default;
  explicit DescriptorSet(std::span<const map::Descriptor> descriptors,
                         Arithmetic arithmetic = Arithmetic::kFastest);

  std::size_t size() const {
    return std::visit([](const auto& form) { return form.size(); }, form_);
  }

 private:
  friend std::vector<DescriptorMatch> MatchDescriptors(
      const DescriptorSet& queries,
      const DescriptorSet& references,
      double ratio);

  std::variant<internal::WideDescriptors, internal::InterleavedDescriptors>
      form_;
};

struct DescriptorMatch {
  std::uint32_t query = 0;
  std::uint32_t reference = 0;
  std::int32_t squared_distance = 0;

  friend bool operator==(const DescriptorMatch&,
                         const DescriptorMatch&) = default;
};

// For each query its nearest reference, kept if d1 / d2 <= ratio, where d1 and
// d2 are the Euclidean distances to the nearest and the second nearest
// (Robinson 2014, §3.4; Lowe 2004, §7.1). Ties go to the lower index. No match
// without a second reference. Ordered by query. Arithmetic is exact, so results
// are the same on every machine. Both sets must be of one arithmetic.
std::vector<DescriptorMatch> MatchDescriptors(const DescriptorSet& queries,
                                              const DescriptorSet& references,
                                              double ratio);

}  // namespace groundlock::features

#endif  // GROUNDLOCK_MAP_STORE_FEATURES_DESCRIPTOR_MATCHING_H_
