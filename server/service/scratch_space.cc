// SPDX-License-Identifier: Apache-2.0
#include "server/service/scratch_space.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;

// flock() on a directory, held until the descriptor is closed; -1 if it fails.
int LockDirectory(const fs::path& path, int operation) {
  const int fd = open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return -1;
  while (flock(fd, operation) != 0) {
    if (errno == EINTR) continue;
    close(fd);
    return -1;
  }
  return fd;
}

}  // namespace

ScratchDirectory::ScratchDirectory(base::TemporaryDirectory directory,
                                   int lock_fd)
    : directory_(std::move(directory)), lock_fd_(lock_fd) {}

ScratchDirectory::~ScratchDirectory() { close(lock_fd_); }

ScratchSpace::ScratchSpace(fs::path root) : root_(std::move(root)) {}

absl::StatusOr<std::unique_ptr<ScratchSpace>> ScratchSpace::Open(
    const fs::path& root) {
  std::error_code error;
  fs::create_directories(root, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot create ", root.string(), ": ", error.message()));
  }
  // Nobody creates a directory, and has not locked it yet, meanwhile.
  const int root_fd = LockDirectory(root, LOCK_EX);
  if (root_fd < 0) {
    return absl::ErrnoToStatus(errno,
                               absl::StrCat("cannot lock ", root.string()));
  }
  for (const fs::directory_entry& entry : fs::directory_iterator(root, error)) {
    if (!entry.is_directory(error) ||
        !entry.path().filename().string().starts_with(".tmp-")) {
      continue;
    }
    const int fd = LockDirectory(entry.path(), LOCK_EX | LOCK_NB);
    if (fd < 0) continue;  // in use by another server
    fs::remove_all(entry.path(), error);
    close(fd);
  }
  close(root_fd);
  return std::unique_ptr<ScratchSpace>(new ScratchSpace(root));
}

absl::StatusOr<std::unique_ptr<ScratchDirectory>> ScratchSpace::Create() const {
  const int root_fd = LockDirectory(root_, LOCK_SH);
  if (root_fd < 0) {
    return absl::ErrnoToStatus(errno,
                               absl::StrCat("cannot lock ", root_.string()));
  }
  auto directory = base::TemporaryDirectory::Create(root_);
  int fd = -1;
  if (directory.ok()) fd = LockDirectory(directory->path(), LOCK_EX);
  close(root_fd);
  RETURN_IF_ERROR(directory.status());
  if (fd < 0) {
    return absl::InternalError(
        absl::StrCat("cannot lock ", directory->path().string()));
  }
  return std::unique_ptr<ScratchDirectory>(
      new ScratchDirectory(*std::move(directory), fd));
}

}  // namespace groundlock::service
