// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/text_reader.h"

#include "map_store/base/status.h"

namespace groundlock::formats::internal {

using base::Abseil;

std::string_view Trim(std::string_view text) {
  while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
  return text;
}

bool TextReader::NextLine(std::string_view* line) {
  if (rest_.empty()) return false;
  const std::size_t end = rest_.find('\n');
  *line = rest_.substr(0, end);
  rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
  ++line_number_;
  return true;
}

bool TextReader::NextRecord(std::string_view* line) {
  while (NextLine(line)) {
    const std::string_view trimmed = Trim(*line);
    if (!trimmed.empty() && trimmed.front() != '#') return true;
  }
  return false;
}

absl::Status TextReader::Error(std::string_view what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(Abseil(file_), ":", line_number_, ": ", Abseil(what)));
}

}  // namespace groundlock::formats::internal
