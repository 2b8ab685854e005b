// SPDX-License-Identifier: Apache-2.0
// What a stranger may send to the dashboard before anything is known of it:
// a request's target and headers, and a page's first messages. Nothing crashes,
// and what is accepted keeps what it promises.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "client/dashboard/proxy/http_rules.h"
#include "client/dashboard/proxy/request_rules.h"

namespace {

using groundlock::dashboard::ParseRange;
using groundlock::dashboard::ParseRequest;
using groundlock::dashboard::ParseTarget;

void Require(bool holds) {
  if (!holds) std::abort();
}

void CheckTarget(std::string_view text) {
  const auto target = ParseTarget(text);
  if (!target.ok()) return;
  Require(!target->path.empty());
  for (const std::string& segment : target->path) {
    Require(segment != "." && segment != ".." &&
            segment.find('/') == std::string::npos &&
            segment.find('\0') == std::string::npos);
  }
  if (!groundlock::dashboard::ValidateUploadPath(target->path).ok()) return;
  for (const std::string& segment : target->path) {
    Require(!segment.empty() && segment.front() != '.');
  }
}

void CheckRange(std::string_view text, std::uint64_t size) {
  const auto range = ParseRange(text, size);
  if (!range.ok()) return;
  Require(range->begin <= range->end && range->end <= size);
  Require(!range->partial || range->begin < range->end);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size < 2) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 2,
                              size - 2);
  switch (data[0] % 5) {
    case 0:
      CheckTarget(text);
      break;
    case 1:
      CheckRange(text, data[1]);
      break;
    case 2:
      groundlock::dashboard::CookieValue(text, "groundlock_login");
      groundlock::dashboard::AcceptsGzip(text);
      groundlock::dashboard::MimeType(text);
      break;
    case 3: {
      const std::size_t middle = text.empty() ? 0 : data[1] % text.size();
      const std::vector<std::string> allowed = {"https://dash.example.org"};
      groundlock::dashboard::OriginAllowed(
          text.substr(0, middle), text.substr(middle), allowed);
      groundlock::dashboard::HostAllowed(text, allowed);
      break;
    }
    default: {
      const auto request = ParseRequest(text);
      if (request.ok()) Require(request->request_id() > 0);
    }
  }
  return 0;
}
