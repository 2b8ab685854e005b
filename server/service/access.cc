// SPDX-License-Identifier: Apache-2.0
#include "server/service/access.h"

#include <algorithm>
#include <cstddef>
#include <system_error>
#include <utility>

#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

constexpr std::string_view kScheme = "Bearer ";
constexpr std::size_t kMinLength = 16;
constexpr std::size_t kMaxLength = 1024;
constexpr std::uint64_t kMaxFileBytes = 1 << 20;

// Looks at every byte whatever it finds.
bool Equal(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  volatile unsigned char difference = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    difference = difference | static_cast<unsigned char>(a[i] ^ b[i]);
  }
  return difference == 0;
}

bool IsPrintable(char c) { return c > ' ' && c < '\x7f'; }

}  // namespace

absl::Status Access::CheckHeader(std::string_view header) const {
  if (open_to_all()) return absl::OkStatus();
  if (header.empty()) {
    return absl::UnauthenticatedError(
        "this server wants a token: none was given");
  }
  if (header.substr(0, kScheme.size()) != kScheme) {
    return absl::UnauthenticatedError("authorization: expected Bearer TOKEN");
  }
  const std::string_view token = header.substr(kScheme.size());
  bool known = false;
  for (const std::string& one : tokens_) known |= Equal(one, token);
  if (!known) return absl::UnauthenticatedError("the token is not known");
  return absl::OkStatus();
}

absl::Status Access::Check(const grpc::CallbackServerContext& context) const {
  if (open_to_all()) return absl::OkStatus();
  const auto& metadata = context.client_metadata();
  const auto found = metadata.find("authorization");
  if (found == metadata.end()) return CheckHeader({});
  return CheckHeader({found->second.data(), found->second.size()});
}

absl::StatusOr<std::vector<std::string>> ReadTokenFile(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxFileBytes));
  std::error_code error;
  const auto permissions = std::filesystem::status(path, error).permissions();
  if (error || (permissions & (std::filesystem::perms::others_read |
                               std::filesystem::perms::others_write)) !=
                   std::filesystem::perms::none) {
    return absl::FailedPreconditionError(absl::StrCat(
        path.string(), ": everybody on this machine can read it; chmod 600"));
  }
  std::vector<std::string> tokens;
  std::size_t begin = 0;
  for (int number = 1; begin < text.size(); ++number) {
    std::size_t end = std::min(text.find('\n', begin), text.size());
    std::string line = text.substr(begin, end - begin);
    begin = end + 1;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || line.front() == '#') continue;
    if (line.size() < kMinLength || line.size() > kMaxLength ||
        !std::all_of(line.begin(), line.end(), IsPrintable)) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(),
          ":",
          number,
          ": a token has 16 to 1024 printable characters without blanks"));
    }
    tokens.push_back(std::move(line));
  }
  if (tokens.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(path.string(), ": no token in this file"));
  }
  return tokens;
}

}  // namespace groundlock::service
