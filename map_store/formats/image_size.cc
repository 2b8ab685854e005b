// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/image_size.h"

#include <cstdint>
#include <fstream>
#include <string>

#include "map_store/base/image_header.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::formats::internal {
namespace {

// Enough for the metadata that cameras put before the frame header.
constexpr std::size_t kMaxHeaderBytes = std::size_t{1} << 20;

}  // namespace

std::optional<ImageSize> ImageSizeFromHeader(std::string_view bytes) {
  constexpr std::uint32_t kMax = geometry::CameraModel::kMaxSizePx;
  const auto header = base::ReadImageHeader(bytes);
  if (!header || header->width_px > kMax || header->height_px > kMax) {
    return std::nullopt;
  }
  return ImageSize{static_cast<int>(header->width_px),
                   static_cast<int>(header->height_px)};
}

std::optional<ImageSize> ReadImageSize(const std::filesystem::path& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return std::nullopt;
  std::ifstream stream(path, std::ios::binary);
  std::string bytes(kMaxHeaderBytes, '\0');
  stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(stream.gcount()));
  return ImageSizeFromHeader(bytes);
}

}  // namespace groundlock::formats::internal
