// SPDX-License-Identifier: Apache-2.0
// Distances between descriptors, many at a time.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_DESCRIPTOR_DISTANCE_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_DESCRIPTOR_DISTANCE_H_

#include <cstdint>
#include <span>

#include "map_store/map/map_data.h"

namespace groundlock::map::internal {

// distances[i]: the squared Euclidean distance of references[i] from `query`.
// Integers: the same on every machine. Thread-safe.
void SquaredDistances(const Descriptor& query,
                      std::span<const Descriptor> references,
                      std::int32_t* distances);

// The reference nearest to `query`, the first of equals; 0 without references.
std::uint32_t NearestOf(std::span<const Descriptor> references,
                        const Descriptor& query);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_DESCRIPTOR_DISTANCE_H_
