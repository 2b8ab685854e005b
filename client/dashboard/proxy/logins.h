// SPDX-License-Identifier: Apache-2.0
// Who has logged in: cookies and the tokens behind them.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_

#include <chrono>
#include <map>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

// The browser holds a random number, never the token. Logins last for a day
// after their last use; the oldest make room for new ones. Thread-safe.
class Logins {
 public:
  // Remembers a token that the server has accepted. Returns the cookie's value.
  std::string Add(const std::string& token);
  // The token of a cookie; nullopt if it is not known (any more).
  std::optional<std::string> Find(const std::string& cookie);
  void Remove(const std::string& cookie);
  // The server does not accept the token any more.
  void Revoke(const std::string& token);
  // Any token that the server accepts, for what is done for all viewers.
  std::optional<std::string> AnyToken() const;

 private:
  struct Login {
    std::string token;
    std::chrono::steady_clock::time_point last_use;
  };
  mutable base::Mutex mutex_;
  std::map<std::string, Login> logins_ ABSL_GUARDED_BY(mutex_);
};

// 32 hexadecimal digits from the system's random numbers.
std::string RandomId();

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_LOGINS_H_
