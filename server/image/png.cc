// SPDX-License-Identifier: Apache-2.0
#include "server/image/png.h"

#include <algorithm>
#include <array>
#include <opencv2/imgcodecs.hpp>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::image {
namespace {

constexpr std::array<std::uint8_t, 8> kSignature = {
    0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
// Signature, chunk length, "IHDR", width, height (PNG specification, 11.2.2).
constexpr std::size_t kHeaderBytes = 24;
constexpr std::size_t kChunkOverheadBytes = 12;  // length, type, CRC

std::uint32_t BigEndian32(std::span<const std::uint8_t> bytes) {
  return std::uint32_t{bytes[0]} << 24 | std::uint32_t{bytes[1]} << 16 |
         std::uint32_t{bytes[2]} << 8 | std::uint32_t{bytes[3]};
}

bool IsType(std::span<const std::uint8_t> bytes, std::string_view type) {
  return std::equal(type.begin(), type.end(), bytes.begin());
}

// Walks the chunks to IEND. libpng stops reading at the last row and does not
// notice a file that was cut behind it.
absl::Status CheckChunks(std::span<const std::uint8_t> bytes) {
  std::size_t offset = kSignature.size();
  while (bytes.size() - offset >= kChunkOverheadBytes) {
    const std::size_t length = BigEndian32(bytes.subspan(offset));
    if (length > bytes.size() - offset - kChunkOverheadBytes) break;
    if (IsType(bytes.subspan(offset + 4), "IEND")) return absl::OkStatus();
    offset += kChunkOverheadBytes + length;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("PNG: truncated: the chunk at byte ",
                   offset,
                   " is not complete, ",
                   "the data ends at byte ",
                   bytes.size()));
}

}  // namespace

bool HasPngMagic(std::span<const std::uint8_t> bytes) {
  return bytes.size() >= kSignature.size() &&
         std::equal(kSignature.begin(), kSignature.end(), bytes.begin());
}

absl::StatusOr<cv::Size> ReadPngSize(std::span<const std::uint8_t> bytes) {
  if (!HasPngMagic(bytes) || bytes.size() < kHeaderBytes ||
      !IsType(bytes.subspan(12), "IHDR")) {
    return absl::InvalidArgumentError("PNG: damaged or truncated header");
  }
  const std::uint32_t width_px = BigEndian32(bytes.subspan(16));
  const std::uint32_t height_px = BigEndian32(bytes.subspan(20));
  constexpr std::uint32_t kMax = 0x7FFFFFFF;  // PNG specification, 11.2.2
  if (width_px == 0 || height_px == 0 || width_px > kMax || height_px > kMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("PNG: the header says ", width_px, "x", height_px));
  }
  return cv::Size(static_cast<int>(width_px), static_cast<int>(height_px));
}

absl::StatusOr<cv::Mat> DecodePng(std::span<const std::uint8_t> bytes,
                                  cv::Size size_px) {
  RETURN_IF_ERROR(CheckChunks(bytes));
  cv::Mat bgr;
  try {
    // OpenCV takes a non-const buffer but does not write to it.
    const cv::Mat buffer(1,
                         static_cast<int>(bytes.size()),
                         CV_8UC1,
                         const_cast<std::uint8_t*>(bytes.data()));
    // Orientation tags are for viewers; intrinsics belong to the pixels as they
    // lie.
    bgr =
        cv::imdecode(buffer, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception& error) {
    return absl::InvalidArgumentError(
        absl::StrCat("PNG: damaged data: ", error.err));
  }
  if (bgr.empty()) return absl::InvalidArgumentError("PNG: damaged data");
  if (bgr.size() != size_px) {
    return absl::InvalidArgumentError(
        "PNG: the decoded size differs from the header's");
  }
  return bgr;
}

}  // namespace groundlock::image
