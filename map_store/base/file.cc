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
  return absl::ErrnoToStatus(
      errno, absl::StrCat(Abseil(what), " ", path.string()));
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

absl::Status WriteFileAtomically(const fs::path& path,
                                 std::string_view content) {
  std::string temporary = path.string() + ".tmp-XXXXXX";
  const int fd = mkstemp(temporary.data());
  if (fd < 0) return ErrnoStatus("cannot create a file beside", path);
  absl::Status status;
  std::size_t written = 0;
  while (status.ok() && written < content.size()) {
    const ssize_t n =
        write(fd, content.data() + written, content.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      status = ErrnoStatus("cannot write", path);
    } else {
      written += static_cast<std::size_t>(n);
    }
  }
  if (status.ok() && fchmod(fd, 0644) != 0) {
    status = ErrnoStatus("cannot set the mode of", path);
  }
  if (status.ok() && fsync(fd) != 0) status = ErrnoStatus("cannot sync", path);
  close(fd);
  if (status.ok() && rename(temporary.c_str(), path.c_str()) != 0) {
    status = ErrnoStatus("cannot rename to", path);
  }
  if (!status.ok()) unlink(temporary.c_str());
  return status;
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
