// SPDX-License-Identifier: Apache-2.0
// Who has logged in: cookies and the tokens behind them.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_

#include <chrono>
#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

struct Login {
  std::string token;
  // Who that is, as the server said when it was last asked.
  gl::GetCallerResponse caller;
  std::string cookie;  // empty: of nobody who has logged in
};

// The browser holds a random number, never the token. Logins last for a day
// after their last use; the oldest make room for new ones, those of the same
// token first. Thread-safe.
class Logins {
 public:
  explicit Logins(int max) : max_(static_cast<std::size_t>(max)) {}
  // Remembers a token that the server has accepted. Returns the cookie's value.
  std::string Add(const Login& login);
  // Who has the cookie; nullopt if it is not known (any more).
  std::optional<Login> Find(const std::string& cookie);
  void Remove(const std::string& cookie);
  // The server does not accept the token any more.
  void Revoke(const std::string& token);
  // Those that somebody has logged in with, each token once.
  std::vector<Login> All() const;

 private:
  struct Entry {
    Login login;
    std::chrono::steady_clock::time_point last_use;
  };
  const std::size_t max_;
  mutable base::Mutex mutex_;
  std::map<std::string, Entry> logins_ ABSL_GUARDED_BY(mutex_);
};

// 32 hexadecimal digits from the system's random numbers.
std::string RandomId();

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_
