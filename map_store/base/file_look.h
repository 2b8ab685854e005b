// SPDX-License-Identifier: Apache-2.0
// Files that are read again when they have changed, and that hold secrets.
#ifndef GROUNDLOCK_MAP_STORE_BASE_FILE_LOOK_H_
#define GROUNDLOCK_MAP_STORE_BASE_FILE_LOOK_H_

#include <filesystem>
#include <string>

#include "absl/status/status.h"

namespace groundlock::base {

// Changes when the file or its permissions do, or another takes its place (or
// that of what a link leads to); empty if there is none. Reads files of up to
// 1 MiB. Thread-safe.
std::string LookOf(const std::filesystem::path& path);

// kFailedPrecondition, naming the file: others than its owner and group may
// read or write it, or it is not there. Thread-safe.
absl::Status CheckPrivate(const std::filesystem::path& path);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_FILE_LOOK_H_
