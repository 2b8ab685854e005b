// SPDX-License-Identifier: Apache-2.0
// Between VisualSFM's SIFT and RootSIFT, both scaled by 512 to 8 bits.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_DESCRIPTORS_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_DESCRIPTORS_H_

#include <cstdint>
#include <span>

#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

// L2-normalised SIFT (any scale) to RootSIFT: L1-normalised, square root,
// times 512, rounded, at most 255. All zero stays all zero.
// Source: Arandjelovic & Zisserman 2012, section 2.
map::Descriptor RootSiftFromSift(std::span<const std::uint8_t, 128> sift);

// The inverse up to rounding: squared, L2-normalised, times 512.
map::Descriptor SiftFromRootSift(const map::Descriptor& root);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_DESCRIPTORS_H_
