// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMAGE_SIZE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMAGE_SIZE_H_

#include <filesystem>
#include <optional>
#include <string_view>

namespace groundlock::formats::internal {

struct ImageSize {
  int width_px = 0;
  int height_px = 0;
  friend bool operator==(const ImageSize&, const ImageSize&) = default;
};

// The size that the header of a JPEG (its first frame, ITU-T T.81, B.2.2) or
// PNG (IHDR) states, without decoding. nullopt if there is none in the bytes.
std::optional<ImageSize> ImageSizeFromHeader(std::string_view bytes);

// The same from the first megabyte of a file.
std::optional<ImageSize> ReadImageSize(const std::filesystem::path& path);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMAGE_SIZE_H_
