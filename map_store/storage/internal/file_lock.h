// SPDX-License-Identifier: Apache-2.0
// Advisory locks that die with their holder, however that ends. Two locks of
// one process exclude each other like those of two.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_

#include <filesystem>
#include <optional>

#include "absl/status/statusor.h"

namespace groundlock::storage::internal {

class FileLock {
 public:
  // Exclusive. Creates the file if need be and waits for the lock.
  static absl::StatusOr<FileLock> Acquire(const std::filesystem::path& path);
  // Exclusive. nullopt if somebody holds the lock. Creates the file if need be.
  static absl::StatusOr<std::optional<FileLock>> TryAcquire(
      const std::filesystem::path& path);
  // As TryAcquire, but kNotFound if there is no such file.
  static absl::StatusOr<std::optional<FileLock>> TryAcquireExisting(
      const std::filesystem::path& path);
  // Shared: any number may hold one, nobody an exclusive one meanwhile. nullopt
  // if somebody holds that. kNotFound if there is no such file.
  static absl::StatusOr<std::optional<FileLock>> TryShare(
      const std::filesystem::path& path);
  FileLock(FileLock&& other) noexcept;
  FileLock& operator=(FileLock&& other) noexcept;
  ~FileLock();

  // The file has no name any more: somebody removed it before it was locked.
  bool IsRemoved() const;

 private:
  explicit FileLock(int fd) : fd_(fd) {}
  static absl::StatusOr<std::optional<FileLock>> TryLock(
      const std::filesystem::path& path, int open_flags, int operation);
  int fd_;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_FILE_LOCK_H_
