// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_address.h"

#include <libpq-fe.h>

#include <memory>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

// Replaces the values of parameters whose name contains "password".
std::string HideParameters(std::string_view query) {
  std::string shown;
  while (!query.empty()) {
    const std::string_view parameter = query.substr(0, query.find('&'));
    const std::size_t equals = parameter.find('=');
    // A name may be written with %-escapes: then it is hidden as well.
    const bool secret =
        absl::StrContains(absl::AsciiStrToLower(base::Abseil(parameter)),
                          "password") ||
        parameter.substr(0, equals).find('%') != std::string_view::npos;
    if (secret && equals != std::string_view::npos) {
      absl::StrAppend(
          &shown, base::Abseil(parameter.substr(0, equals)), "=***");
    } else {
      absl::StrAppend(&shown, base::Abseil(parameter));
    }
    query.remove_prefix(parameter.size());
    if (!query.empty()) {
      shown += '&';
      query.remove_prefix(1);
    }
  }
  return shown;
}

}  // namespace

bool IsPostgresUrl(std::string_view text) {
  return absl::StartsWith(base::Abseil(text), "postgresql://") ||
         absl::StartsWith(base::Abseil(text), "postgres://");
}

absl::Status ValidatePostgresUrl(const std::string& url) {
  char* message = nullptr;
  const std::unique_ptr<PQconninfoOption, decltype(&PQconninfoFree)> parsed(
      PQconninfoParse(url.c_str(), &message), &PQconninfoFree);
  const std::unique_ptr<char, decltype(&PQfreemem)> owned(message, &PQfreemem);
  if (parsed != nullptr) return absl::OkStatus();
  // libpq's message repeats parts of the URL: shown only if none is secret.
  const std::string shown = UrlWithoutPassword(url);
  return absl::InvalidArgumentError(absl::StrCat(
      "store: cannot parse ",
      shown,
      ": expected postgresql://USER@HOST:PORT/DATABASE",
      shown == url && message != nullptr ? absl::StrCat(": ", message) : ""));
}

std::string UrlWithoutPassword(const std::string& url) {
  const std::size_t start = url.find("://") + 3;
  // The last '@': a password that was not escaped may hold '@', '/' and '?'.
  const std::size_t at = url.rfind('@');
  std::string shown = url.substr(0, start);
  std::size_t rest = start;
  if (at != std::string::npos && at >= start) {
    const std::string user_info = url.substr(start, at - start);
    const std::size_t colon = user_info.find(':');
    shown += user_info.substr(0, colon);
    if (colon != std::string::npos) shown += ":***";
    rest = at;
  }
  const std::size_t query = url.find('?', rest);
  shown += url.substr(rest, query - rest);
  if (query != std::string::npos) {
    absl::StrAppend(
        &shown, "?", HideParameters(std::string_view(url).substr(query + 1)));
  }
  return shown;
}

}  // namespace groundlock::storage::internal
