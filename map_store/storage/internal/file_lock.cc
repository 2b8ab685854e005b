// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/file_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace groundlock::storage::internal {
namespace {

absl::StatusOr<int> OpenLockFile(const std::filesystem::path& path, int flags) {
  const int fd = open(path.c_str(), flags | O_CLOEXEC, 0644);
  if (fd < 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("open ", path.string()));
  }
  return fd;
}

int Flock(int fd, int operation) {
  int result = 0;
  do {
    result = flock(fd, operation);
  } while (result != 0 && errno == EINTR);
  return result;
}

}  // namespace

absl::StatusOr<FileLock> FileLock::Acquire(const std::filesystem::path& path) {
  const absl::StatusOr<int> fd = OpenLockFile(path, O_RDWR | O_CREAT);
  if (!fd.ok()) return fd.status();
  FileLock lock(*fd);
  if (Flock(*fd, LOCK_EX) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("lock ", path.string()));
  }
  return lock;
}

absl::StatusOr<std::optional<FileLock>> FileLock::TryLock(
    const std::filesystem::path& path, int open_flags, int operation) {
  const absl::StatusOr<int> fd = OpenLockFile(path, open_flags);
  if (!fd.ok()) return fd.status();
  FileLock lock(*fd);
  if (Flock(*fd, operation | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK) return std::nullopt;
    return absl::ErrnoToStatus(errno, absl::StrCat("lock ", path.string()));
  }
  return lock;
}

absl::StatusOr<std::optional<FileLock>> FileLock::TryAcquire(
    const std::filesystem::path& path) {
  return TryLock(path, O_RDWR | O_CREAT, LOCK_EX);
}

absl::StatusOr<std::optional<FileLock>> FileLock::TryAcquireExisting(
    const std::filesystem::path& path) {
  // For writing: network file systems want that for an exclusive lock.
  return TryLock(path, O_RDWR, LOCK_EX);
}

absl::StatusOr<std::optional<FileLock>> FileLock::TryShare(
    const std::filesystem::path& path) {
  return TryLock(path, O_RDONLY | O_NONBLOCK, LOCK_SH);
}

FileLock::FileLock(FileLock&& other) noexcept
    : fd_(std::exchange(other.fd_, -1)) {}

FileLock& FileLock::operator=(FileLock&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

FileLock::~FileLock() {
  if (fd_ >= 0) close(fd_);  // releases the lock
}

bool FileLock::IsRemoved() const {
  struct stat status {};
  return fstat(fd_, &status) != 0 || status.st_nlink == 0;
}

}  // namespace groundlock::storage::internal
