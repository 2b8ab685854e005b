// SPDX-License-Identifier: Apache-2.0
// VisualSFM's binary feature files: "SIFT", "V4.0" or "V5.0", three int32
// (features, 5, 128), per feature five floats (x, y, colour, scale,
// orientation), per feature 128 bytes, then "\xFFEOF".
#include <cstring>

#include "map_store/base/status.h"
#include "map_store/formats/internal/binary_reader.h"
#include "map_store/formats/internal/nvm_model.h"

namespace groundlock::formats::internal {
namespace {

constexpr std::size_t kLocationBytes = 5 * sizeof(float);
constexpr std::size_t kDescriptorBytes = 128;

}  // namespace

absl::StatusOr<SiftFile> SiftFile::Parse(std::string_view bytes,
                                         std::string_view file) {
  BinaryReader reader(bytes, file);
  const std::string_view name = reader.ReadBytes(4);
  const std::string_view version = reader.ReadBytes(4);
  if (name != "SIFT" || (version != "V4.0" && version != "V5.0")) {
    return absl::InvalidArgumentError(absl::StrCat(
        base::Abseil(file),
        ": not VisualSFM's binary .sift format (SIFTV4.0 or SIFTV5.0)",
        LooksLikeText(bytes) ? "; Lowe's text format is not supported" : ""));
  }
  const auto count = reader.Read<std::int32_t>();
  const auto num_floats = reader.Read<std::int32_t>();
  const auto num_bytes = reader.Read<std::int32_t>();
  RETURN_IF_ERROR(reader.CheckOk("the header"));
  if (count < 0 || num_floats != 5 || num_bytes != 128) {
    return reader.Error(absl::StrCat("the header says ",
                                     count,
                                     " features of ",
                                     num_floats,
                                     " floats and ",
                                     num_bytes,
                                     " bytes; expected 5 and 128"));
  }
  SiftFile sift;
  sift.size_ = static_cast<std::size_t>(count);
  RETURN_IF_ERROR(reader.CheckCount(
      sift.size_, kLocationBytes + kDescriptorBytes, "features"));
  sift.locations_ = reader.ReadBytes(sift.size_ * kLocationBytes);
  sift.descriptors_ = reader.ReadBytes(sift.size_ * kDescriptorBytes);
  return sift;
}

Eigen::Vector2f SiftFile::KeypointPx(std::size_t index) const {
  Eigen::Vector2f xy;
  std::memcpy(
      xy.data(), locations_.data() + index * kLocationBytes, 2 * sizeof(float));
  return xy;
}

std::span<const std::uint8_t, 128> SiftFile::Descriptor(
    std::size_t index) const {
  return std::span<const std::uint8_t, 128>(
      reinterpret_cast<const std::uint8_t*>(descriptors_.data()) +
          index * kDescriptorBytes,
      kDescriptorBytes);
}

}  // namespace groundlock::formats::internal
