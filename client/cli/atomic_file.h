// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_CLI_ATOMIC_FILE_H_
#define GROUNDLOCK_CLIENT_CLI_ATOMIC_FILE_H_

#include <filesystem>
#include <fstream>
#include <memory>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::cli {

// The hidden name that a file has beside its final one while it is written.
std::filesystem::path PartialPath(const std::filesystem::path& path);

// A text file written bit by bit to PartialPath and renamed at the end: what
// stands at `path` is whole. (base::WriteFileAtomically wants all at once.)
class AtomicFile {
 public:
  // Errors name the path: no such folder, no permission.
  static absl::StatusOr<std::unique_ptr<AtomicFile>> Create(
      const std::filesystem::path& path);
  ~AtomicFile();  // without Finish: removes what was written

  absl::Status Append(std::string_view text);
  absl::Status Finish();

 private:
  explicit AtomicFile(const std::filesystem::path& path);
  absl::Status Error() const;

  const std::filesystem::path path_;
  std::ofstream file_;
  bool finished_ = false;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_ATOMIC_FILE_H_
