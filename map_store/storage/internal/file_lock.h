// SPDX-License-Identifier: Apache-2.0
// An exclusive advisory lock that dies with its holder, however that ends.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_

#include <filesystem>
#include <optional>

#include "absl/status/statusor.h"

namespace groundlock::storage::internal {

class FileLock {
 public:
  // Creates the file if need be and waits for the lock.
  static absl::StatusOr<FileLock> Acquire(const std::filesystem::path& path);
  // nullopt if somebody, in this process or another, holds the lock.
  static absl::StatusOr<std::optional<FileLock>> TryAcquire(
      const std::filesystem::path& path);
  FileLock(FileLock&& other) noexcept;
  FileLock& operator=(FileLock&& other) noexcept;
  ~FileLock();

 private:
  explicit FileLock(int fd) : fd_(fd) {}
  int fd_;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_
