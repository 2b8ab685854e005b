// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/staging.h"

#include <system_error>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

namespace fs = std::filesystem;

constexpr const char* kLockName = "lock";

}  // namespace

absl::StatusOr<Staging> StagingArea::Make() const {
  // The folder and the lock that protects it appear as one to a sweep.
  ASSIGN_OR_RETURN(const FileLock making, FileLock::Acquire(lock_));
  ASSIGN_OR_RETURN(base::TemporaryDirectory directory,
                   base::TemporaryDirectory::Create(folder_));
  ASSIGN_OR_RETURN(FileLock in_use,
                   FileLock::Acquire(directory.path() / kLockName));
  return Staging(std::move(directory), std::move(in_use));
}

absl::Status StagingArea::Sweep() const {
  std::error_code error;
  fs::create_directories(folder_, error);
  if (!error) {
    ASSIGN_OR_RETURN(const FileLock lock, FileLock::Acquire(lock_));
    for (fs::directory_iterator it(folder_, error), end; !error && it != end;
         it.increment(error)) {
      // Only what we made ourselves is ours to remove.
      if (!absl::StartsWith(it->path().filename().string(), ".tmp-")) continue;
      std::error_code ignored;  // it will be tried again on the next opening
      if (!fs::is_directory(it->symlink_status(ignored))) continue;
      const auto held = FileLock::TryAcquire(it->path() / kLockName);
      if (!held.ok() || !held->has_value()) continue;  // in use
      fs::remove_all(it->path(), ignored);
    }
  }
  if (!error) return absl::OkStatus();
  return absl::ErrnoToStatus(error.value(),
                             absl::StrCat("cannot prepare ", folder_.string()));
}

}  // namespace groundlock::storage::internal
