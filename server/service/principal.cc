// SPDX-License-Identifier: Apache-2.0
#include "server/service/principal.h"

#include <array>
#include <utility>

namespace groundlock::service {
namespace {

constexpr std::array<std::pair<std::string_view, Scopes>, 6> kScopeTable = {{
    {"maps:read", kNoScopes | Scope::kMapsRead},
    {"maps:write", Scope::kMapsRead | Scope::kMapsWrite},
    {"sessions:own", kNoScopes | Scope::kSessionsOwn},
    {"sessions:watch", kNoScopes | Scope::kSessionsWatch},
    {"sessions:all",
     Scope::kSessionsOwn | Scope::kSessionsWatch | Scope::kSessionsAll},
    {"admin",
     Scope::kMapsRead | Scope::kMapsWrite | Scope::kSessionsOwn |
         Scope::kSessionsWatch | Scope::kSessionsAll},
}};

}  // namespace

Scopes ScopesOf(std::string_view name) {
  for (const auto& [scope, includes] : kScopeTable) {
    if (scope == name) return includes;
  }
  return kNoScopes;
}

std::vector<std::string> ScopeNames(Scopes scopes) {
  std::vector<std::string> names;
  for (const auto& [scope, includes] : kScopeTable) {
    if ((scopes & includes) == includes) names.emplace_back(scope);
  }
  return names;
}

absl::Status Principal::CheckValid() const {
  if (withdrawn != nullptr && *withdrawn) {
    return absl::UnauthenticatedError(
        "what this call was let in by does not count any more");
  }
  if (std::chrono::system_clock::now() > expires) {
    return absl::UnauthenticatedError("the token has expired");
  }
  return absl::OkStatus();
}

}  // namespace groundlock::service
