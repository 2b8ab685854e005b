// SPDX-License-Identifier: Apache-2.0
// Files: bounded reads and writes that are whole or absent.
#ifndef GROUNDLOCK_MAP_STORE_BASE_FILE_H_
#define GROUNDLOCK_MAP_STORE_BASE_FILE_H_

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::base {

// The whole file. kNotFound if it does not exist, kInvalidArgument if it is no
// regular file, kResourceExhausted if it holds more than max_bytes (checked
// before anything is allocated). Messages name the path.
absl::StatusOr<std::string> ReadFile(const std::filesystem::path& path,
                                     std::uint64_t max_bytes);

// Writes to a temporary file beside `path`, syncs it and renames it over
// `path`: a reader sees the old content or the new, never a part.
absl::Status WriteFileAtomically(const std::filesystem::path& path,
                                 std::string_view content);

// Tells who waits for the file which port is served on: a line with the
// number, whole or absent. Who has read it may remove it and its folder at
// once: nothing there is touched after it appears. A power failure may lose it.
absl::Status WritePortFile(const std::filesystem::path& path, int port);

// A file that is written piece by piece and appears at `path` whole, on Commit,
// or not at all: until then it is a temporary file beside it, named
// PATH.tmp-XXXXXX and removed on destruction. Not thread-safe.
class AtomicFile {
 public:
  static absl::StatusOr<AtomicFile> Create(const std::filesystem::path& path);
  AtomicFile(AtomicFile&& other) noexcept;
  AtomicFile& operator=(AtomicFile&& other) noexcept;
  ~AtomicFile();

  // Appends. After an error the file is good for nothing but destruction.
  absl::Status Write(std::string_view bytes);
  // Overwrites bytes that were written before.
  absl::Status WriteAt(std::uint64_t offset, std::string_view bytes);
  // Syncs the content, renames it to `path` and syncs the directory: on OK the
  // file survives a power failure.
  absl::Status Commit();
  // Renames it to `path` and leaves it to the kernel when to write what.
  absl::Status CommitUnsynced();

 private:
  AtomicFile(std::filesystem::path path, std::string temporary, int fd);
  absl::Status SetMode();
  absl::Status Rename();

  std::filesystem::path path_;
  std::string temporary_;  // empty = nothing to remove
  int fd_ = -1;
};

// Makes renames and new files in the directory survive a power failure.
absl::Status SyncDirectory(const std::filesystem::path& directory);

// A fresh directory inside `parent`, removed with its content on destruction
// unless released. Not thread-safe.
class TemporaryDirectory {
 public:
  static absl::StatusOr<TemporaryDirectory> Create(
      const std::filesystem::path& parent);
  TemporaryDirectory(TemporaryDirectory&& other) noexcept;
  TemporaryDirectory& operator=(TemporaryDirectory&& other) noexcept;
  ~TemporaryDirectory();

  const std::filesystem::path& path() const { return path_; }
  // Gives up ownership: the directory stays. Returns its path.
  std::filesystem::path Release();

 private:
  explicit TemporaryDirectory(std::filesystem::path path);
  std::filesystem::path path_;  // empty = released
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_FILE_H_
