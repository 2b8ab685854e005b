// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_NAMES_LIST_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_NAMES_LIST_H_

#include <algorithm>
#include <span>
#include <string>

#include "absl/strings/str_cat.h"

namespace groundlock::build::internal {

// "a, b, c, d and 7 more".
inline std::string NamesList(std::span<const std::string> names) {
  constexpr std::size_t kShown = 4;
  std::string list;
  for (std::size_t i = 0; i < std::min(kShown, names.size()); ++i) {
    absl::StrAppend(&list, i > 0 ? ", " : "", names[i]);
  }
  if (names.size() > kShown) {
    absl::StrAppend(&list, " and ", names.size() - kShown, " more");
  }
  return list;
}

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_NAMES_LIST_H_
