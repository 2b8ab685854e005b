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

// The size that base::ReadImageHeader finds, if a camera may have it.
std::optional<ImageSize> ImageSizeFromHeader(std::string_view bytes);

// The same from the first megabyte of a file.
std::optional<ImageSize> ReadImageSize(const std::filesystem::path& path);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMAGE_SIZE_H_
