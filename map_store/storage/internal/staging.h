// SPDX-License-Identifier: Apache-2.0
// Folders for files in the making, which a dead process leaves to be swept and
// a living one does not.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_STAGING_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_STAGING_H_

#include <filesystem>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/file.h"
#include "map_store/storage/internal/file_lock.h"

namespace groundlock::storage::internal {

// A folder of one's own, locked while it is in use and removed at the end.
class Staging {
 public:
  const std::filesystem::path& path() const { return directory_.path(); }

 private:
  friend class StagingArea;
  Staging(base::TemporaryDirectory directory, FileLock in_use)
      : in_use_(std::move(in_use)), directory_(std::move(directory)) {}

  FileLock in_use_;  // let go after the folder is gone
  base::TemporaryDirectory directory_;
};

// Thread-safe, and safe against other processes on the same folder.
class StagingArea {
 public:
  //   folder  where the folders are made; created if absent.
  //   lock    a file, held for moments: making and sweeping folders.
  StagingArea(std::filesystem::path folder, std::filesystem::path lock)
      : folder_(std::move(folder)), lock_(std::move(lock)) {}

  absl::StatusOr<Staging> Make() const;
  // Removes what dead processes left.
  absl::Status Sweep() const;

 private:
  const std::filesystem::path folder_;
  const std::filesystem::path lock_;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_STAGING_H_
