// SPDX-License-Identifier: Apache-2.0
// All viewers that are connected, for what goes to everybody.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_AUDIENCE_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_AUDIENCE_H_

#include <cstddef>
#include <functional>
#include <map>
#include <memory>

#include "absl/base/thread_annotations.h"
#include "client/dashboard/proxy/logins.h"
#include "client/dashboard/proxy/outbox.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

// A viewer as others see it. Thread-safe.
class Listener {
 public:
  virtual ~Listener() = default;
  virtual void Send(Buffer message) = 0;
  // Sends the last words, if there are any, and closes.
  virtual void Dismiss(Buffer last_words) = 0;
  virtual const Login& login() const = 0;
};

// Thread-safe.
class Audience {
 public:
  explicit Audience(std::size_t max) : max_(max) {}

  // False: there are too many.
  bool Add(const std::shared_ptr<Listener>& listener) {
    base::MutexLock lock(&mutex_);
    if (listeners_.size() >= max_) return false;
    listeners_[listener.get()] = listener;
    return true;
  }
  void Remove(const Listener* listener) {
    base::MutexLock lock(&mutex_);
    listeners_.erase(listener);
  }
  std::size_t size() const {
    base::MutexLock lock(&mutex_);
    return listeners_.size();
  }
  void ForEach(const std::function<void(Listener&)>& visit) const {
    std::map<const Listener*, std::weak_ptr<Listener>> listeners;
    {
      base::MutexLock lock(&mutex_);
      listeners = listeners_;
    }
    for (const auto& [key, weak] : listeners) {
      if (const auto listener = weak.lock()) visit(*listener);
    }
  }

 private:
  const std::size_t max_;
  mutable base::Mutex mutex_;
  std::map<const Listener*, std::weak_ptr<Listener>> listeners_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_AUDIENCE_H_
