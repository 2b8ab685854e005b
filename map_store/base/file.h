// SPDX-License-Identifier: Apache-2.0
// Files: bounded reads and writes that are whole or absent.
#ifndef GROUNDLOCK_MAP_STORE_BASE_FILE_H_
#define GROUNDLOCK_MAP_STORE_BASE_FILE_H_

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::base {

// The whole file. kNotFound if it does not exist, kInvalidArgument if it is no
// regular file, kResourceExhausted if it holds more than max_bytes (checked
// before anything is allocated). Messages name the path.
absl::StatusOr<std::string> ReadFile(const std::filesystem::path& path,
                                     std::uint64_t max_bytes);

// Writes to a temporary file beside `path`, syncs it and renames it over
// `path`: a reader sees the old content or the new, never a part.
absl::Status WriteFileAtomically(const std::filesystem::path& path,
                                 std::string_view content);

// A fresh directory inside `parent`, removed with its content on destruction
// unless released. Not thread-safe.
class TemporaryDirectory {
 public:
  static absl::StatusOr<TemporaryDirectory> Create(
      const std::filesystem::path& parent);
  TemporaryDirectory(TemporaryDirectory&& other) noexcept;
  TemporaryDirectory& operator=(TemporaryDirectory&& other) noexcept;
  ~TemporaryDirectory();

  const std::filesystem::path& path() const { return path_; }
  // Gives up ownership: the directory stays. Returns its path.
  std::filesystem::path Release();

 private:
  explicit TemporaryDirectory(std::filesystem::path path);
  std::filesystem::path path_;  // empty = released
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_FILE_H_
