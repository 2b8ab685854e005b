// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/descriptor_matching.h"

#include <algorithm>

namespace groundlock::features {

DescriptorSet::DescriptorSet(std::span<const map::Descriptor> descriptors,
                             Arithmetic arithmetic) {
  if (arithmetic == Arithmetic::kFastest &&
      internal::InterleavedDescriptors::IsSupported()) {
    form_ = internal::InterleavedDescriptors(descriptors);
  } else {
    form_ = internal::WideDescriptors(descriptors);
  }
}

std::vector<DescriptorMatch> MatchDescriptors(const DescriptorSet& queries,
                                              const DescriptorSet& references,
                                              double ratio) {
  std::vector<DescriptorMatch> matches;
  if (references.size() < 2 || queries.size() == 0) return matches;
  std::vector<internal::NearestTwo> nearest(queries.size());
  // Sets of one process have one form, unless a test asks for another.
  std::visit(
      [&](const auto& form) {
        using Form = std::decay_t<decltype(form)>;
        Form::Find(form, std::get<Form>(references.form_), nearest);
      },
      queries.form_);
  const double squared_ratio = ratio * ratio;
  for (std::size_t q = 0; q < nearest.size(); ++q) {
    const internal::NearestTwo& best = nearest[q];
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
