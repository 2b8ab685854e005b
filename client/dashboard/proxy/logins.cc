// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/logins.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>

namespace groundlock::dashboard {
namespace {

using Clock = std::chrono::steady_clock;

// So that one token does not push out the others.
constexpr std::ptrdiff_t kMaxLoginsOfToken = 50;
constexpr std::chrono::hours kLifetime{24};

}  // namespace

std::string RandomId() {
  constexpr char kDigits[] = "0123456789abcdef";
  std::random_device source;  // the kernel's generator
  std::string id;
  for (int word = 0; word < 4; ++word) {
    std::uint32_t bits = source();
    for (int i = 0; i < 8; ++i, bits >>= 4) id.push_back(kDigits[bits & 0xF]);
  }
  return id;
}

std::string Logins::Add(const Login& login) {
  const std::string cookie = RandomId() + RandomId();
  base::MutexLock lock(&mutex_);
  const auto is_of_token = [&login](const auto& one) {
    return one.second.login.token == login.token;
  };
  const bool has_many =
      std::count_if(logins_.begin(), logins_.end(), is_of_token) >=
      kMaxLoginsOfToken;
  if (has_many || logins_.size() >= max_) {
    logins_.erase(std::min_element(
        logins_.begin(), logins_.end(), [&](const auto& a, const auto& b) {
          if (has_many && is_of_token(a) != is_of_token(b)) {
            return is_of_token(a);
          }
          return a.second.last_use < b.second.last_use;
        }));
  }
  Entry& entry = logins_[cookie];
  entry = {login, Clock::now()};
  entry.login.cookie = cookie;
  return cookie;
}

std::optional<Login> Logins::Find(const std::string& cookie) {
  base::MutexLock lock(&mutex_);
  const auto found = logins_.find(cookie);
  if (found == logins_.end()) return std::nullopt;
  const auto now = Clock::now();
  if (now - found->second.last_use > kLifetime) {
    logins_.erase(found);
    return std::nullopt;
  }
  found->second.last_use = now;
  return found->second.login;
}

void Logins::Remove(const std::string& cookie) {
  base::MutexLock lock(&mutex_);
  logins_.erase(cookie);
}

void Logins::Revoke(const std::string& token) {
  base::MutexLock lock(&mutex_);
  std::erase_if(logins_, [&](const auto& login) {
    return login.second.login.token == token;
  });
}

std::vector<Login> Logins::All() const {
  std::map<std::string, Login> by_token;
  {
    base::MutexLock lock(&mutex_);
    for (const auto& [cookie, entry] : logins_) {
      by_token.emplace(entry.login.token, entry.login);
    }
  }
  std::vector<Login> all;
  for (auto& [token, login] : by_token) all.push_back(std::move(login));
  return all;
}

}  // namespace groundlock::dashboard
