// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/mapped_file.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::base {

absl::StatusOr<MappedFile> MappedFile::Open(const std::filesystem::path& path,
                                            std::uint64_t max_bytes) {
  // O_NONBLOCK: a named pipe must not hold up the caller.
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0 && (errno == ENOENT || errno == ENOTDIR)) {
    return absl::NotFoundError(absl::StrCat(path.string(), ": no such file"));
  }
  if (fd < 0) {
    return Annotate(absl::ErrnoToStatus(errno, "cannot open"), path.string());
  }
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode)) {
    close(fd);
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": not a regular file"));
  }
  const auto size = static_cast<std::uint64_t>(status.st_size);
  void* data = nullptr;
  if (size > 0 && size <= max_bytes) {
    data = mmap(nullptr, size, PROT_READ, MAP_PRIVATE, fd, 0);
  }
  const int error = errno;
  close(fd);  // the mapping stays
  if (size > max_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        path.string(), ": ", size, " bytes, more than the limit ", max_bytes));
  }
  if (data == MAP_FAILED) {
    return Annotate(absl::ErrnoToStatus(error, "cannot map"), path.string());
  }
  // Parsers go from the first byte to the last.
  if (data != nullptr) madvise(data, size, MADV_SEQUENTIAL);
  return MappedFile(std::string_view(static_cast<const char*>(data), size));
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : bytes_(std::exchange(other.bytes_, {})) {}

MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  std::swap(bytes_, other.bytes_);
  return *this;
}

MappedFile::~MappedFile() {
  if (!bytes_.empty()) {
    munmap(const_cast<char*>(bytes_.data()), bytes_.size());
  }
}

}  // namespace groundlock::base
