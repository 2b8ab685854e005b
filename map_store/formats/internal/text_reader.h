// SPDX-License-Identifier: Apache-2.0
// Reads lines of numbers out of text that nobody vouches for; errors name the
// file and the line.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_TEXT_READER_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_TEXT_READER_H_

#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>

#include "absl/status/status.h"

namespace groundlock::formats::internal {

inline bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
std::string_view Trim(std::string_view text);

// The blank-separated words of one line, taken from the front.
class Words {
 public:
  explicit Words(std::string_view line) : rest_(line) {}

  // Empty at the end of the line.
  std::string_view Next() {
    std::size_t begin = 0;
    while (begin < rest_.size() && IsBlank(rest_[begin])) ++begin;
    std::size_t end = begin;
    while (end < rest_.size() && !IsBlank(rest_[end])) ++end;
    const std::string_view word = rest_.substr(begin, end - begin);
    rest_.remove_prefix(end);
    return word;
  }
  // What is left, blanks trimmed.
  std::string_view Rest() const { return Trim(rest_); }

  // The next word as a whole number of type T (out of range and fractions
  // fail) or as a finite floating-point number.
  template <typename T>
  bool Next(T* value) {
    std::string_view word = Next();
    if (!word.empty() && word.front() == '+') word.remove_prefix(1);
    // A float is parsed as a double: as a float, 1e-60 would be out of range.
    using Parsed = std::conditional_t<std::is_same_v<T, float>, double, T>;
    Parsed parsed{};
    const char* end = word.data() + word.size();
    const auto [stop, error] = std::from_chars(word.data(), end, parsed);
    if (error != std::errc{} || stop != end) return false;
    *value = static_cast<T>(parsed);
    if constexpr (std::is_floating_point_v<T>) return std::isfinite(*value);
    return true;
  }

 private:
  std::string_view rest_;
};

class TextReader {
 public:
  // `file` names the text in messages; both outlive the reader.
  TextReader(std::string_view text, std::string_view file)
      : rest_(text), file_(file) {}

  // The next line as it is, without its end. False at the end of the text.
  bool NextLine(std::string_view* line);
  // The next line that is neither blank nor a comment (#).
  bool NextRecord(std::string_view* line);

  std::size_t line_number() const { return line_number_; }  // of the last line
  std::size_t remaining() const { return rest_.size(); }
  // kInvalidArgument "<file>:<line>: <what>".
  absl::Status Error(std::string_view what) const;

 private:
  std::string_view rest_;
  std::string_view file_;
  std::size_t line_number_ = 0;
};

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_TEXT_READER_H_
