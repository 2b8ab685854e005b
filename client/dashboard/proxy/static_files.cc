// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/static_files.h"

#include <system_error>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/http_rules.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMaxFileBytes = 64 << 20;

}  // namespace

absl::StatusOr<StaticFile> ReadStaticFile(const fs::path& root,
                                          const std::vector<std::string>& path,
                                          bool accept_gzip) {
  std::error_code error;
  if (root.empty() || !fs::is_regular_file(root / "index.html", error)) {
    return absl::FailedPreconditionError("the page was not built");
  }
  fs::path file = root;
  for (const std::string& segment : path) {
    // Hidden files are nobody's, and an empty segment stands at the end only.
    if (segment.starts_with('.') ||
        (segment.empty() && &segment != &path.back())) {
      return absl::NotFoundError("no such page");
    }
    file /= segment.empty() ? "index.html" : segment;
  }
  StaticFile result;
  result.mime = MimeType(file.filename().string());
  result.immutable = path.size() > 1 && path.front() == "assets";
  fs::path chosen = file;
  if (accept_gzip) {
    fs::path compressed = file;
    compressed += ".gz";
    if (fs::is_regular_file(compressed, error)) {
      chosen = compressed;
      result.gzip = true;
    }
  }
  if (!fs::is_regular_file(chosen, error)) {
    return absl::NotFoundError("no such page");
  }
  const auto time = fs::last_write_time(chosen, error);
  ASSIGN_OR_RETURN(result.bytes, base::ReadFile(chosen, kMaxFileBytes));
  result.etag = absl::StrCat("\"",
                             absl::Hex(result.bytes.size()),
                             "-",
                             absl::Hex(time.time_since_epoch().count()),
                             result.gzip ? "-gz\"" : "\"");
  return result;
}

}  // namespace groundlock::dashboard
