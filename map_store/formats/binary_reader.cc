// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/binary_reader.h"

#include <algorithm>

#include "map_store/base/status.h"

namespace groundlock::formats::internal {

using base::Abseil;

std::string_view BinaryReader::ReadCString(std::size_t max_size) {
  if (!ok_) return {};
  const std::string_view window = bytes_.substr(offset_, max_size + 1);
  const std::size_t end = window.find('\0');
  if (end == std::string_view::npos) {
    ok_ = false;
    return {};
  }
  offset_ += end + 1;
  return window.substr(0, end);
}

absl::Status BinaryReader::CheckCount(std::uint64_t count,
                                      std::size_t min_item_bytes,
                                      std::string_view what) const {
  RETURN_IF_ERROR(CheckOk(what));
  if (count <= remaining() / min_item_bytes) return absl::OkStatus();
  return Error(absl::StrCat(count,
                            " ",
                            Abseil(what),
                            " announced, but only ",
                            remaining(),
                            " bytes follow"));
}

absl::Status BinaryReader::Error(std::string_view what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(Abseil(file_), ": byte ", offset_, ": ", Abseil(what)));
}

absl::Status BinaryReader::CheckOk(std::string_view what) const {
  if (ok_) return absl::OkStatus();
  return Error(absl::StrCat("the file ends inside ", Abseil(what)));
}

absl::Status BinaryReader::CheckAtEnd() const {
  RETURN_IF_ERROR(CheckOk("a record"));
  if (remaining() == 0) return absl::OkStatus();
  return Error(
      absl::StrCat(remaining(), " bytes are left after the last item"));
}

bool LooksLikeText(std::string_view bytes) {
  const std::string_view head = bytes.substr(0, 8);
  return !head.empty() && std::all_of(head.begin(), head.end(), [](char c) {
    return (c >= ' ' && c <= '~') || c == '\n' || c == '\r' || c == '\t';
  });
}

}  // namespace groundlock::formats::internal
