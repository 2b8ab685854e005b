// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <system_error>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::base {
namespace {

namespace fs = std::filesystem;

absl::Status ErrnoStatus(std::string_view what, const fs::path& path) {
  return absl::ErrnoToStatus(errno,
                             absl::StrCat(Abseil(what), " ", path.string()));
}

}  // namespace

absl::StatusOr<std::string> ReadFile(const fs::path& path,
                                     std::uint64_t max_bytes) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) {
    return absl::NotFoundError(absl::StrCat(path.string(), ": no such file"));
  }
  if (!fs::is_regular_file(status)) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": not a regular file"));
  }
  const std::uint64_t size = fs::file_size(path, error);
  if (error) {
    return absl::InternalError(
        absl::StrCat(path.string(), ": ", error.message()));
  }
  if (size > max_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        path.string(), ": ", size, " bytes, more than the limit ", max_bytes));
  }
  std::string content(size, '\0');
  std::ifstream stream(path, std::ios::binary);
  if (!stream.read(content.data(), static_cast<std::streamsize>(size))) {
    return absl::InternalError(absl::StrCat(path.string(), ": cannot read"));
  }
  return content;
}

absl::StatusOr<AtomicFile> AtomicFile::Create(const fs::path& path) {
  std::string temporary = path.string() + ".tmp-XXXXXX";
  const int fd = mkostemp(temporary.data(), O_CLOEXEC);
  if (fd < 0) return ErrnoStatus("cannot create a file beside", path);
  return AtomicFile(path, std::move(temporary), fd);
}

AtomicFile::AtomicFile(fs::path path, std::string temporary, int fd)
    : path_(std::move(path)), temporary_(std::move(temporary)), fd_(fd) {}

AtomicFile::AtomicFile(AtomicFile&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::exchange(other.temporary_, {})),
      fd_(std::exchange(other.fd_, -1)) {}

AtomicFile& AtomicFile::operator=(AtomicFile&& other) noexcept {
  std::swap(path_, other.path_);
  std::swap(temporary_, other.temporary_);
  std::swap(fd_, other.fd_);
  return *this;
}

AtomicFile::~AtomicFile() {
  if (fd_ >= 0) close(fd_);
  if (!temporary_.empty()) unlink(temporary_.c_str());
}

absl::Status AtomicFile::Write(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = write(fd_, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return ErrnoStatus("cannot write", path_);
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return absl::OkStatus();
}

absl::Status AtomicFile::WriteAt(std::uint64_t offset, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n =
        pwrite(fd_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return ErrnoStatus("cannot write", path_);
    bytes.remove_prefix(static_cast<std::size_t>(n));
    offset += static_cast<std::uint64_t>(n);
  }
  return absl::OkStatus();
}

absl::Status AtomicFile::Commit() {
  RETURN_IF_ERROR(SetMode());
  if (fsync(fd_) != 0) return ErrnoStatus("cannot sync", path_);
  RETURN_IF_ERROR(Rename());
  return SyncDirectory(path_.has_parent_path() ? path_.parent_path() : ".");
}

absl::Status AtomicFile::CommitUnsynced() {
  RETURN_IF_ERROR(SetMode());
  return Rename();
}

absl::Status AtomicFile::SetMode() {
  if (fchmod(fd_, 0644) == 0) return absl::OkStatus();
  return ErrnoStatus("cannot set the mode of", path_);
}

absl::Status AtomicFile::Rename() {
  if (rename(temporary_.c_str(), path_.c_str()) != 0) {
    return ErrnoStatus("cannot rename to", path_);
  }
  temporary_.clear();
  return absl::OkStatus();
}

absl::Status SyncDirectory(const fs::path& directory) {
  const int fd = open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return ErrnoStatus("cannot open", directory);
  absl::Status status;
  // Some network file systems refuse to sync a directory (EINVAL): there is
  // nothing more to be had there.
  if (fsync(fd) != 0 && errno != EINVAL) {
    status = ErrnoStatus("cannot sync", directory);
  }
  close(fd);
  return status;
}

absl::Status WriteFileAtomically(const fs::path& path,
                                 std::string_view content) {
  ASSIGN_OR_RETURN(AtomicFile file, AtomicFile::Create(path));
  RETURN_IF_ERROR(file.Write(content));
  return file.Commit();
}

absl::Status WritePortFile(const fs::path& path, int port) {
  ASSIGN_OR_RETURN(AtomicFile file, AtomicFile::Create(path));
  RETURN_IF_ERROR(file.Write(absl::StrCat(port, "\n")));
  return file.CommitUnsynced();
}

absl::StatusOr<TemporaryDirectory> TemporaryDirectory::Create(
    const fs::path& parent) {
  std::string name = (parent / ".tmp-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) {
    return ErrnoStatus("cannot create a directory in", parent);
  }
  return TemporaryDirectory(name);
}

TemporaryDirectory::TemporaryDirectory(fs::path path)
    : path_(std::move(path)) {}

TemporaryDirectory::TemporaryDirectory(TemporaryDirectory&& other) noexcept
    : path_(std::exchange(other.path_, {})) {}

TemporaryDirectory& TemporaryDirectory::operator=(
    TemporaryDirectory&& other) noexcept {
  std::swap(path_, other.path_);
  return *this;
}

TemporaryDirectory::~TemporaryDirectory() {
  if (path_.empty()) return;
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

fs::path TemporaryDirectory::Release() { return std::exchange(path_, {}); }

}  // namespace groundlock::base
