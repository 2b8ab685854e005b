// SPDX-License-Identifier: Apache-2.0
// Notices that threads with a queue have come to a standstill.
#ifndef GROUNDLOCK_SERVER_SERVICE_WATCHDOG_H_
#define GROUNDLOCK_SERVER_SERVICE_WATCHDOG_H_

#include <chrono>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "server/service/progress.h"

namespace groundlock::service {

// Asks its charges for their progress on a thread of its own.
class Watchdog {
 public:
  struct Charge {
    std::string name;
    std::function<Progress()> progress;
    // Work that waits so long, while none is finished, stands still.
    std::chrono::nanoseconds patience;
  };
  // standing: what stands still and for how long, one line; empty when all goes
  // on again. Called from the thread, when that changes.
  using Report = std::function<void(const std::string& standing)>;

  Watchdog(std::vector<Charge> charges, Report report);
  // After it no report comes any more.
  ~Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

 private:
  struct Watched {
    Charge charge;
    std::uint64_t done = 0;
    std::chrono::steady_clock::time_point since;  // of the last progress
    bool stands = false;
  };
  void Work();
  // Whether anything begins or ceases to stand still.
  bool Look(std::chrono::steady_clock::time_point now);
  std::string Describe() const;

  std::vector<Watched> watched_;  // the thread's alone
  const Report report_;
  std::chrono::nanoseconds interval_;
  base::Mutex mutex_;
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WATCHDOG_H_
