// SPDX-License-Identifier: Apache-2.0
// Temporary directories of uploads and exports, and nothing left of them.
#ifndef GROUNDLOCK_SERVER_SERVICE_SCRATCH_SPACE_H_
#define GROUNDLOCK_SERVER_SERVICE_SCRATCH_SPACE_H_

#include <filesystem>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/file.h"

namespace groundlock::service {

// A directory that is removed with its content on destruction. While it exists
// it is locked, so that another server on the same store leaves it alone.
class ScratchDirectory {
 public:
  ~ScratchDirectory();
  ScratchDirectory(const ScratchDirectory&) = delete;
  ScratchDirectory& operator=(const ScratchDirectory&) = delete;
  const std::filesystem::path& path() const { return directory_.path(); }

 private:
  friend class ScratchSpace;
  ScratchDirectory(base::TemporaryDirectory directory, int lock_fd);
  base::TemporaryDirectory directory_;
  int lock_fd_;
};

// Thread-safe, and safe against other processes.
class ScratchSpace {
 public:
  // Creates `root` if absent and removes what servers that died have left
  // there.
  static absl::StatusOr<std::unique_ptr<ScratchSpace>> Open(
      const std::filesystem::path& root);
  absl::StatusOr<std::unique_ptr<ScratchDirectory>> Create() const;

 private:
  explicit ScratchSpace(std::filesystem::path root);
  const std::filesystem::path root_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SCRATCH_SPACE_H_
