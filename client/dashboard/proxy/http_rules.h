// SPDX-License-Identifier: Apache-2.0
// What a request's target and headers mean. Everything here is untrusted text.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_RULES_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_RULES_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::dashboard {

struct Target {
  // Decoded segments of the path; "/a//b/" has "a", "", "b", "".
  std::vector<std::string> path;
  std::map<std::string, std::string> query;  // the last of each name
};

// Of "/a/b?c=d". kInvalidArgument: not an absolute path, a broken escape, a
// control character, or a segment that is "." or "..".
absl::StatusOr<Target> ParseTarget(std::string_view target);

// The value of a cookie; nullopt if it is not there.
std::optional<std::string> CookieValue(std::string_view header,
                                       std::string_view name);

// [begin, end) of a body. Of several ranges, or one that is not understood, the
// whole body. kOutOfRange: nothing of what was asked for exists.
struct ByteRange {
  std::uint64_t begin = 0;
  std::uint64_t end = 0;
  bool partial = false;
};
absl::StatusOr<ByteRange> ParseRange(std::string_view header,
                                     std::uint64_t size);

// Whether a page of `origin` (the Origin header, empty = none was sent) may
// speak to the dashboard that was called by `host` (the Host header): its own
// page, or one of `allowed` ("scheme://host[:port]").
bool OriginAllowed(std::string_view origin,
                   std::string_view host,
                   const std::vector<std::string>& allowed);

// Whether `host` is a name under which the dashboard may be called: an IP
// address, localhost, or the host of one of `allowed`. Others would be names
// that a foreign page points at this machine.
bool HostAllowed(std::string_view host,
                 const std::vector<std::string>& allowed);

// A relative path of an upload's file: 1 to 16 segments of 1 to 255 bytes, none
// that starts with a dot, no control characters or backslashes.
absl::Status ValidateUploadPath(const std::vector<std::string>& segments);

// Names of recordings: 1 to 64 of [A-Za-z0-9._-], not starting with . or -.
absl::Status ValidateName(std::string_view name, std::string_view field);

// By the file's extension; application/octet-stream for what is not known.
std::string_view MimeType(std::string_view path);

// Whether an Accept-Encoding header allows gzip.
bool AcceptsGzip(std::string_view header);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_RULES_H_
