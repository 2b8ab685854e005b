// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/xmp.h"

#include <charconv>
#include <cmath>
#include <cstddef>
#include <system_error>

#include "absl/strings/ascii.h"
#include "map_store/base/status.h"

namespace groundlock::formats::internal {
namespace {

// What an APP1 segment with a packet begins with, the zero included.
constexpr std::string_view kXmpHeader{"http://ns.adobe.com/xap/1.0/\0", 29};

constexpr unsigned kStartOfImage = 0xD8;
constexpr unsigned kStartOfScan = 0xDA;
constexpr unsigned kEndOfImage = 0xD9;
constexpr unsigned kApp1 = 0xE1;

unsigned ByteAt(std::string_view bytes, std::size_t i) {
  return static_cast<unsigned char>(bytes[i]);
}

bool IsSpace(char c) {
  return absl::ascii_isspace(static_cast<unsigned char>(c));
}

std::string_view WithoutLeadingSpace(std::string_view text) {
  while (!text.empty() && IsSpace(text.front())) text.remove_prefix(1);
  return text;
}

std::optional<double> Number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0.0;
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stop != end || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

std::optional<double> NumberOrFraction(std::string_view text) {
  text = base::Std(absl::StripAsciiWhitespace(base::Abseil(text)));
  const std::size_t slash = text.find('/');
  if (slash == std::string_view::npos) return Number(text);
  const auto over = Number(text.substr(0, slash));
  const auto under = Number(text.substr(slash + 1));
  if (!over || !under || *under == 0.0) return std::nullopt;
  const double value = *over / *under;
  return std::isfinite(value) ? std::optional(value) : std::nullopt;
}

// The text of an attribute, from behind its name on; nullopt if that is none.
std::optional<std::string_view> AttributeText(std::string_view text) {
  text = WithoutLeadingSpace(text);
  if (!text.starts_with('=')) return std::nullopt;
  text = WithoutLeadingSpace(text.substr(1));
  if (!text.starts_with('"') && !text.starts_with('\'')) return std::nullopt;
  const std::size_t end = text.find(text.front(), 1);
  if (end == std::string_view::npos) return std::nullopt;
  return text.substr(1, end - 1);
}

}  // namespace

std::string_view XmpPacket(std::string_view jpeg) {
  if (jpeg.size() < 2 || ByteAt(jpeg, 0) != 0xFF ||
      ByteAt(jpeg, 1) != kStartOfImage) {
    return {};
  }
  std::size_t at = 2;
  while (at + 4 <= jpeg.size() && ByteAt(jpeg, at) == 0xFF) {
    const unsigned marker = ByteAt(jpeg, at + 1);
    if (marker == 0xFF) {  // markers may be filled up with these
      ++at;
      continue;
    }
    if (marker == kStartOfScan || marker == kEndOfImage) break;
    // The length counts its own two bytes.
    const std::size_t length =
        (ByteAt(jpeg, at + 2) << 8U) + ByteAt(jpeg, at + 3);
    if (length < 2 || jpeg.size() - at - 2 < length) break;
    const std::string_view segment = jpeg.substr(at + 4, length - 2);
    if (marker == kApp1 && segment.starts_with(kXmpHeader)) {
      return segment.substr(kXmpHeader.size());
    }
    at += 2 + length;
  }
  return {};
}

std::optional<double> XmpNumber(std::string_view packet,
                                std::string_view name) {
  for (std::size_t at = packet.find(name); at != std::string_view::npos;
       at = packet.find(name, at + name.size())) {
    if (at == 0) continue;
    const char before = packet[at - 1];
    const std::string_view behind = packet.substr(at + name.size());
    if (before == '<' && behind.starts_with('>')) {
      const std::size_t end = behind.find('<');
      if (end == std::string_view::npos) return std::nullopt;
      return NumberOrFraction(behind.substr(1, end - 1));
    }
    if (!IsSpace(before)) continue;
    if (const auto text = AttributeText(behind)) return NumberOrFraction(*text);
  }
  return std::nullopt;
}

}  // namespace groundlock::formats::internal
