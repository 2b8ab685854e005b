// SPDX-License-Identifier: Apache-2.0
// Macros and small helpers around absl::Status, which crosses every library
// boundary of Groundlock. Messages name the file, line, field or frame at
// fault.
#ifndef GROUNDLOCK_MAP_STORE_BASE_STATUS_H_
#define GROUNDLOCK_MAP_STORE_BASE_STATUS_H_

#include <string>
#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"

namespace groundlock::base {

// Debian's absl::string_view is not std::string_view: this is the one bridge.
inline absl::string_view Abseil(std::string_view text) {
  return {text.data(), text.size()};
}
inline std::string_view Std(absl::string_view text) {
  return {text.data(), text.size()};
}

// The same status with "context: " put before its message; OK stays OK.
inline absl::Status Annotate(const absl::Status& status,
                             std::string_view context) {
  if (status.ok()) return status;
  return absl::Status(status.code(),
                      absl::StrCat(Abseil(context), ": ", status.message()));
}

}  // namespace groundlock::base

#define GROUNDLOCK_CONCAT_INNER(a, b) a##b
#define GROUNDLOCK_CONCAT(a, b) GROUNDLOCK_CONCAT_INNER(a, b)

// Returns from the function if `expression` is not OK.
#define RETURN_IF_ERROR(expression)                       \
  do {                                                    \
    if (::absl::Status status_macro_value = (expression); \
        !status_macro_value.ok()) {                       \
      return status_macro_value;                          \
    }                                                     \
  } while (false)

// The left side may be a declaration: it cannot stand in parentheses.
// NOLINTBEGIN(bugprone-macro-parentheses)
// ASSIGN_OR_RETURN(auto value, MakeValue()): the value, or returns its error.
#define ASSIGN_OR_RETURN(lhs, expression) \
  ASSIGN_OR_RETURN_INNER(                 \
      GROUNDLOCK_CONCAT(status_or_, __LINE__), lhs, expression)
#define ASSIGN_OR_RETURN_INNER(status_or, lhs, expression)   \
  auto status_or = (expression);                             \
  if (!status_or.ok()) return std::move(status_or).status(); \
  lhs = *std::move(status_or)
// NOLINTEND(bugprone-macro-parentheses)

#endif  // GROUNDLOCK_MAP_STORE_BASE_STATUS_H_
