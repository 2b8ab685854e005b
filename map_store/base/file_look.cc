// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/file_look.h"

#include <sys/stat.h>

#include <cstdint>
#include <functional>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"

namespace groundlock::base {

namespace fs = std::filesystem;

namespace {
constexpr std::uint64_t kMaxLookedAtBytes = 1 << 20;
}  // namespace

std::string LookOf(const fs::path& path) {
  struct stat now {};
  if (stat(path.c_str(), &now) != 0) return "";
  std::string look = absl::StrCat(now.st_ino,
                                  " ",
                                  now.st_mode,
                                  " ",
                                  now.st_size,
                                  " ",
                                  now.st_mtim.tv_sec,
                                  " ",
                                  now.st_mtim.tv_nsec);
  // A clock that ticks slowly gives two writings the same time.
  if (const auto content = ReadFile(path, kMaxLookedAtBytes); content.ok()) {
    absl::StrAppend(&look, " ", std::hash<std::string>()(*content));
  }
  return look;
}

absl::Status CheckPrivate(const fs::path& path) {
  std::error_code error;
  const fs::perms permissions = fs::status(path, error).permissions();
  if (error || (permissions & (fs::perms::others_read |
                               fs::perms::others_write)) != fs::perms::none) {
    return absl::FailedPreconditionError(absl::StrCat(
        path.string(), ": everybody on this machine can read it; chmod 600"));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::base
