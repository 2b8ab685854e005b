// SPDX-License-Identifier: Apache-2.0
// What an image's first bytes say about its size. A file of some kilobytes may
// decode to gigabytes: whoever decodes a stranger's image asks here first.
#ifndef GROUNDLOCK_MAP_STORE_BASE_IMAGE_HEADER_H_
#define GROUNDLOCK_MAP_STORE_BASE_IMAGE_HEADER_H_

#include <cstdint>
#include <optional>
#include <string_view>

#include "absl/status/status.h"

namespace groundlock::base {

struct ImageHeader {
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
};

// The size of the (first) image in a JPEG (ITU-T T.81, B.2.2), PNG (IHDR), BMP,
// TIFF (6.0, not BigTIFF), WebP (RFC 9649) or PBM, PGM, PPM file, from its
// bytes: the first megabyte does, except for a TIFF, whose directory may lie at
// the end. nullopt if there is none in the bytes or it says 0.
std::optional<ImageHeader> ReadImageHeader(std::string_view bytes);

// kInvalidArgument if the bytes are no image of a kind named above;
// kResourceExhausted if it has more than `max_pixels`.
absl::Status CheckImageSize(std::string_view bytes, std::uint64_t max_pixels);

// Pixels of a photo that is decoded for a map: more than cameras on the market
// take, and 400 MB in colour.
inline constexpr std::uint64_t kMaxPhotoPixels = std::uint64_t{1} << 27;

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_IMAGE_HEADER_H_
