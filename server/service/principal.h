// SPDX-License-Identifier: Apache-2.0
// Somebody who calls, and what for.
#ifndef GROUNDLOCK_SERVER_SERVICE_PRINCIPAL_H_
#define GROUNDLOCK_SERVER_SERVICE_PRINCIPAL_H_

#include <atomic>
#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::service {

// What a method asks for; see base::kScopes. A principal's scopes include what
// they imply.
enum class Scope : unsigned {
  kMapsRead = 1,
  kMapsWrite = 2,
  kSessionsOwn = 4,
  kSessionsWatch = 8,
  kSessionsAll = 16,
};

// A set of scopes, of Scope.
using Scopes = unsigned;
inline constexpr Scopes kNoScopes = 0;
constexpr Scopes operator|(Scope a, Scope b) {
  return static_cast<unsigned>(a) | static_cast<unsigned>(b);
}
constexpr Scopes operator|(Scopes a, Scope b) {
  return a | static_cast<unsigned>(b);
}

// What a scope of base::kScopes includes; none of another name.
Scopes ScopesOf(std::string_view name);
// The names of all that are in `scopes`.
std::vector<std::string> ScopeNames(Scopes scopes);

class Account;

struct Principal {
  // Unlike all others': of the token file, or "jwt:SUBJECT".
  std::string name;
  // Whose maps and sessions there are for it.
  std::string tenant;
  Scopes scopes = kNoScopes;
  std::chrono::system_clock::time_point expires =
      std::chrono::system_clock::time_point::max();
  // Set once, when what it was known by does not count any more.
  std::shared_ptr<const std::atomic<bool>> withdrawn;
  // What it uses; null = that is not looked at.
  std::shared_ptr<Account> account;

  bool May(Scope scope) const {
    return (scopes & static_cast<unsigned>(scope)) != 0;
  }
  // kUnauthenticated: it counted when the call began, and does not any more.
  absl::Status CheckValid() const;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_PRINCIPAL_H_
