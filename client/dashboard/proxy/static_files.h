// SPDX-License-Identifier: Apache-2.0
// The built page's files.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_STATIC_FILES_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_STATIC_FILES_H_

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::dashboard {

struct StaticFile {
  std::string bytes;
  std::string_view mime;
  std::string etag;
  bool gzip = false;       // bytes are compressed
  bool immutable = false;  // its name changes with its content
};

// path: decoded segments, none of which is "." or ".."; an empty last one means
// index.html. accept_gzip: FILE.gz may be sent if it lies beside FILE.
// kNotFound; kFailedPrecondition: there is no page at all.
absl::StatusOr<StaticFile> ReadStaticFile(const std::filesystem::path& root,
                                          const std::vector<std::string>& path,
                                          bool accept_gzip);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_STATIC_FILES_H_
