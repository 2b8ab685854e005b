// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/file_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace groundlock::storage::internal {
namespace {

absl::StatusOr<int> OpenLockFile(const std::filesystem::path& path) {
  const int fd = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
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
  const absl::StatusOr<int> fd = OpenLockFile(path);
  if (!fd.ok()) return fd.status();
  FileLock lock(*fd);
  if (Flock(*fd, LOCK_EX) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("lock ", path.string()));
  }
  return lock;
}

absl::StatusOr<std::optional<FileLock>> FileLock::TryAcquire(
    const std::filesystem::path& path) {
  const absl::StatusOr<int> fd = OpenLockFile(path);
  if (!fd.ok()) return fd.status();
  FileLock lock(*fd);
  if (Flock(*fd, LOCK_EX | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK) return std::nullopt;
    return absl::ErrnoToStatus(errno, absl::StrCat("lock ", path.string()));
  }
  return lock;
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

}  // namespace groundlock::storage::internal
