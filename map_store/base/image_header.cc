// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/image_header.h"

#include <algorithm>
#include <cstddef>

#include "absl/strings/str_cat.h"

namespace groundlock::base {
namespace {

// Bytes that are not there read as 0: each caller checks what it relies on.
class Bytes {
 public:
  explicit Bytes(std::string_view bytes) : bytes_(bytes) {}
  std::size_t size() const { return bytes_.size(); }
  bool StartsWith(std::string_view magic, std::size_t at = 0) const {
    return bytes_.size() >= at && bytes_.substr(at, magic.size()) == magic;
  }
  std::uint32_t Byte(std::size_t at) const {
    return at < bytes_.size() ? static_cast<unsigned char>(bytes_[at]) : 0U;
  }
  std::uint32_t BigEndian(std::size_t at, std::size_t count) const {
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < count; ++i) value = value << 8 | Byte(at + i);
    return value;
  }
  std::uint32_t LittleEndian(std::size_t at, std::size_t count) const {
    std::uint32_t value = 0;
    for (std::size_t i = count; i-- > 0;) value = value << 8 | Byte(at + i);
    return value;
  }

 private:
  std::string_view bytes_;
};

bool IsStartOfFrame(std::uint32_t marker) {
  // C4, C8 and CC are tables and extensions, not frames.
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 &&
         marker != 0xCC;
}

ImageHeader Jpeg(const Bytes& bytes) {
  std::size_t at = 2;
  while (at + 4 <= bytes.size()) {
    if (bytes.Byte(at) != 0xFF) return {};
    const std::uint32_t marker = bytes.Byte(at + 1);
    if (marker == 0xFF) {  // fill byte
      ++at;
      continue;
    }
    if (marker == 0x01 || (marker >= 0xD0 && marker <= 0xD7)) {
      at += 2;  // these stand alone
      continue;
    }
    const std::uint32_t length = bytes.BigEndian(at + 2, 2);
    if (length < 2) return {};
    if (IsStartOfFrame(marker)) {
      if (at + 9 > bytes.size()) return {};
      return {bytes.BigEndian(at + 7, 2), bytes.BigEndian(at + 5, 2)};
    }
    at += 2 + length;
  }
  return {};
}

ImageHeader Bmp(const Bytes& bytes) {
  // OS/2's first header has 16-bit sizes; heights below 0: top row first.
  if (bytes.LittleEndian(14, 4) == 12) {
    return {bytes.LittleEndian(18, 2), bytes.LittleEndian(20, 2)};
  }
  const std::uint32_t height = bytes.LittleEndian(22, 4);
  return {bytes.LittleEndian(18, 4),
          height > 0x7FFFFFFFU ? 0U - height : height};
}

ImageHeader Tiff(const Bytes& bytes) {
  const bool little = bytes.Byte(0) == 'I';
  const auto read = [&](std::size_t at, std::size_t count) {
    return little ? bytes.LittleEndian(at, count) : bytes.BigEndian(at, count);
  };
  ImageHeader header;
  const std::size_t directory = read(4, 4);
  const std::uint32_t num_entries = read(directory, 2);
  for (std::uint32_t i = 0; i < num_entries; ++i) {
    const std::size_t entry = directory + 2 + std::size_t{12} * i;
    if (entry + 12 > bytes.size()) return {};
    const std::uint32_t tag = read(entry, 2);
    if (tag != 256 && tag != 257) continue;
    const std::uint32_t type = read(entry + 2, 2);
    if (type != 3 && type != 4) return {};  // SHORT, LONG
    const std::uint32_t value = read(entry + 8, type == 3 ? 2 : 4);
    // Which of two entries of one kind counts is the decoder's choice.
    std::uint32_t& size = tag == 256 ? header.width_px : header.height_px;
    size = std::max(size, value);
  }
  return header;
}

ImageHeader WebP(const Bytes& bytes) {
  if (bytes.StartsWith("VP8X", 12)) {
    return {bytes.LittleEndian(24, 3) + 1, bytes.LittleEndian(27, 3) + 1};
  }
  if (bytes.StartsWith("VP8L", 12) && bytes.Byte(20) == 0x2F) {
    const std::uint32_t sizes = bytes.LittleEndian(21, 4);
    return {(sizes & 0x3FFF) + 1, (sizes >> 14 & 0x3FFF) + 1};
  }
  if (bytes.StartsWith("VP8 ", 12)) {
    return {bytes.LittleEndian(26, 2) & 0x3FFF,
            bytes.LittleEndian(28, 2) & 0x3FFF};
  }
  return {};
}

// C's isspace.
bool IsBlank(std::uint32_t c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

// Numbers in ASCII; between them blanks, and comments from # to the line's end.
ImageHeader Netpbm(const Bytes& bytes) {
  std::size_t at = 2;
  std::uint32_t sizes[2] = {};
  for (std::uint32_t& size : sizes) {
    for (;; ++at) {
      const std::uint32_t c = bytes.Byte(at);
      if (c == '#') {
        while (at < bytes.size() && bytes.Byte(at) != '\n' &&
               bytes.Byte(at) != '\r') {
          ++at;
        }
      } else if (!IsBlank(c)) {
        break;
      }
    }
    for (; bytes.Byte(at) >= '0' && bytes.Byte(at) <= '9'; ++at) {
      if (size > 100'000'000) return {};
      size = 10 * size + (bytes.Byte(at) - '0');
    }
    // Decoders differ in what "2#8" is: for some, 2 and a comment; for OpenCV,
    // which passes over the byte after a number, 2 and 8.
    if (!IsBlank(bytes.Byte(at))) return {};
  }
  return {sizes[0], sizes[1]};
}

ImageHeader Parse(const Bytes& bytes) {
  constexpr std::string_view kPng("\x89PNG\r\n\x1A\n", 8);
  if (bytes.StartsWith(kPng)) {
    if (bytes.size() < 24 || !bytes.StartsWith("IHDR", 12)) return {};
    return {bytes.BigEndian(16, 4), bytes.BigEndian(20, 4)};
  }
  if (bytes.StartsWith("\xFF\xD8")) return Jpeg(bytes);
  if (bytes.StartsWith("BM") && bytes.size() >= 26) return Bmp(bytes);
  if (bytes.StartsWith(std::string_view("II*\0", 4)) ||
      bytes.StartsWith(std::string_view("MM\0*", 4))) {
    return Tiff(bytes);
  }
  if (bytes.StartsWith("RIFF") && bytes.StartsWith("WEBP", 8) &&
      bytes.size() >= 30) {
    return WebP(bytes);
  }
  if (bytes.Byte(0) == 'P' && bytes.Byte(1) >= '1' && bytes.Byte(1) <= '6') {
    return Netpbm(bytes);
  }
  return {};
}

}  // namespace

std::optional<ImageHeader> ReadImageHeader(std::string_view bytes) {
  const ImageHeader header = Parse(Bytes(bytes));
  if (header.width_px == 0 || header.height_px == 0) return std::nullopt;
  return header;
}

absl::Status CheckImageSize(std::string_view bytes, std::uint64_t max_pixels) {
  const std::optional<ImageHeader> header = ReadImageHeader(bytes);
  if (!header.has_value()) {
    return absl::InvalidArgumentError("cannot be read as an image");
  }
  if (std::uint64_t{header->width_px} * header->height_px > max_pixels) {
    return absl::ResourceExhaustedError(absl::StrCat("has ",
                                                     header->width_px,
                                                     "x",
                                                     header->height_px,
                                                     " pixels, more than ",
                                                     max_pixels));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::base
