// SPDX-License-Identifier: Apache-2.0
#include "server/service/watchdog.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/process.h"

namespace groundlock::service {

Watchdog::Watchdog(std::vector<Charge> charges, Report report)
    : report_(std::move(report)), interval_(std::chrono::seconds(1)) {
  const auto now = std::chrono::steady_clock::now();
  for (Charge& charge : charges) {
    interval_ = std::min(interval_, charge.patience / 4);
    watched_.push_back({std::move(charge), 0, now, false});
  }
  thread_ = std::thread([this] { Work(); });
}

Watchdog::~Watchdog() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  thread_.join();
}

bool Watchdog::Look(std::chrono::steady_clock::time_point now) {
  bool changed = false;
  for (Watched& one : watched_) {
    const Progress progress = one.charge.progress();
    if (progress.done != one.done || progress.waiting == 0) {
      one.done = progress.done;
      one.since = now;
    }
    const bool stands = now - one.since > one.charge.patience;
    changed = changed || stands != one.stands;
    one.stands = stands;
  }
  return changed;
}

std::string Watchdog::Describe() const {
  std::vector<std::string> standing;
  for (const Watched& one : watched_) {
    if (!one.stands) continue;
    standing.push_back(absl::StrCat(
        one.charge.name,
        ": nothing finished for ",
        std::chrono::duration_cast<std::chrono::seconds>(one.charge.patience)
            .count(),
        " s while work waits"));
  }
  return absl::StrJoin(standing, "; ");
}

void Watchdog::Work() {
  base::NameThisThread("gl-watchdog");
  for (;;) {
    {
      base::MutexLock lock(&mutex_);
      const bool stop = mutex_.AwaitFor(
          interval_,
          [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return stopping_; });
      if (stop) return;
    }
    if (Look(std::chrono::steady_clock::now())) report_(Describe());
  }
}

}  // namespace groundlock::service
