// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/image_size.h"

#include <cstdint>
#include <fstream>
#include <string>

#include "map_store/geometry/camera_model.h"

namespace groundlock::formats::internal {
namespace {

// Enough for the metadata that cameras put before the frame header.
constexpr std::size_t kMaxHeaderBytes = std::size_t{1} << 20;

std::uint32_t BigEndian(std::string_view bytes, std::size_t at, int size) {
  std::uint32_t value = 0;
  for (int i = 0; i < size; ++i) {
    value = (value << 8) |
            static_cast<unsigned char>(bytes[at + static_cast<std::size_t>(i)]);
  }
  return value;
}

std::optional<ImageSize> Checked(std::uint32_t width_px,
                                 std::uint32_t height_px) {
  constexpr std::uint32_t kMax = geometry::CameraModel::kMaxSizePx;
  if (width_px == 0 || height_px == 0 || width_px > kMax || height_px > kMax) {
    return std::nullopt;
  }
  return ImageSize{static_cast<int>(width_px), static_cast<int>(height_px)};
}

bool IsStartOfFrame(std::uint32_t marker) {
  // C4, C8 and CC are tables and extensions, not frames.
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 &&
         marker != 0xCC;
}

std::optional<ImageSize> JpegSize(std::string_view bytes) {
  std::size_t at = 2;
  while (at + 4 <= bytes.size()) {
    if (BigEndian(bytes, at, 1) != 0xFF) return std::nullopt;
    const std::uint32_t marker = BigEndian(bytes, at + 1, 1);
    if (marker == 0xFF) {  // fill byte
      ++at;
      continue;
    }
    const std::uint32_t length = BigEndian(bytes, at + 2, 2);
    if (length < 2) return std::nullopt;
    if (IsStartOfFrame(marker)) {
      if (at + 9 > bytes.size()) return std::nullopt;
      return Checked(BigEndian(bytes, at + 7, 2), BigEndian(bytes, at + 5, 2));
    }
    at += 2 + length;
  }
  return std::nullopt;
}

}  // namespace

std::optional<ImageSize> ImageSizeFromHeader(std::string_view bytes) {
  constexpr std::string_view kPng("\x89PNG\r\n\x1A\n", 8);
  if (bytes.size() >= 24 && bytes.substr(0, 8) == kPng &&
      bytes.substr(12, 4) == "IHDR") {
    return Checked(BigEndian(bytes, 16, 4), BigEndian(bytes, 20, 4));
  }
  if (bytes.substr(0, 2) == "\xFF\xD8") return JpegSize(bytes);
  return std::nullopt;
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
