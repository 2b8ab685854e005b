// SPDX-License-Identifier: Apache-2.0
#include "client/cli/atomic_file.h"

#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::cli {

namespace fs = std::filesystem;

fs::path PartialPath(const fs::path& path) {
  fs::path partial = path;
  return partial.replace_filename(
      absl::StrCat(".", path.filename().string(), ".partial"));
}

AtomicFile::AtomicFile(const fs::path& path)
    : path_(path), file_(PartialPath(path), std::ios::binary) {}

AtomicFile::~AtomicFile() {
  if (finished_) return;
  file_.close();
  std::error_code ignored;
  fs::remove(PartialPath(path_), ignored);
}

absl::StatusOr<std::unique_ptr<AtomicFile>> AtomicFile::Create(
    const fs::path& path) {
  if (path.filename().empty() || fs::is_directory(path)) {
    return absl::InvalidArgumentError(
        absl::StrCat("\"", path.string(), "\": not the name of a file"));
  }
  errno = 0;
  std::unique_ptr<AtomicFile> file(new AtomicFile(path));
  if (!file->file_) return file->Error();
  return file;
}

absl::Status AtomicFile::Append(std::string_view text) {
  errno = 0;
  file_ << text;
  return file_ ? absl::OkStatus() : Error();
}

absl::Status AtomicFile::Finish() {
  if (finished_) return absl::OkStatus();
  errno = 0;
  file_.close();
  if (!file_) return Error();
  std::error_code error;
  fs::rename(PartialPath(path_), path_, error);
  if (error) {
    return absl::UnavailableError(
        absl::StrCat(path_.string(), ": ", error.message()));
  }
  finished_ = true;
  return absl::OkStatus();
}

absl::Status AtomicFile::Error() const {
  const int code = errno;
  const std::string reason =
      code == 0 ? "cannot be written"
                : std::error_code(code, std::generic_category()).message();
  return absl::UnavailableError(absl::StrCat(path_.string(), ": ", reason));
}

}  // namespace groundlock::cli
