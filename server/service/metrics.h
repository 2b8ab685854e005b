// SPDX-License-Identifier: Apache-2.0
// What the server counts about itself. Counting takes no locks, so it never
// makes one session wait for another; the program decides how to publish it.
#ifndef GROUNDLOCK_SERVER_SERVICE_METRICS_H_
#define GROUNDLOCK_SERVER_SERVICE_METRICS_H_

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "server/service/progress.h"
#include "server/service/spans.h"

namespace groundlock::service {

// Times of a stage, in buckets of powers of two from 0.25 ms on.
class DurationHistogram {
 public:
  static constexpr std::size_t kNumBounds = 15;  // the last is 4,096 ms
  static constexpr double UpperBoundMs(std::size_t bucket) {
    return 0.25 * static_cast<double>(1U << bucket);
  }

  void Add(std::chrono::nanoseconds duration) {
    const double ms =
        std::chrono::duration<double, std::milli>(duration).count();
    std::size_t bucket = 0;
    while (bucket < kNumBounds && ms > UpperBoundMs(bucket)) ++bucket;
    counts_[bucket].fetch_add(1, std::memory_order_relaxed);
    sum_ns_.fetch_add(
        static_cast<std::uint64_t>(std::max<std::int64_t>(0, duration.count())),
        std::memory_order_relaxed);
  }
  // Bucket kNumBounds holds what is above all bounds. Not cumulative.
  std::uint64_t count(std::size_t bucket) const {
    return counts_[bucket].load(std::memory_order_relaxed);
  }
  double sum_ms() const {
    return static_cast<double>(sum_ns_.load(std::memory_order_relaxed)) * 1e-6;
  }

 private:
  std::array<std::atomic<std::uint64_t>, kNumBounds + 1> counts_{};
  std::atomic<std::uint64_t> sum_ns_{0};
};

// How far the server's threads with queues have come, asked for when somebody
// wants to know. Thread-safe.
class QueueProgress {
 public:
  using Source = std::function<Progress()>;

  // By name; none when the threads end.
  void Set(std::vector<std::pair<std::string, Source>> sources) {
    base::MutexLock lock(&mutex_);
    sources_ = std::move(sources);
  }
  std::vector<std::pair<std::string, Progress>> Read() const {
    std::vector<std::pair<std::string, Progress>> progress;
    base::MutexLock lock(&mutex_);
    for (const auto& [name, source] : sources_) {
      progress.emplace_back(name, source());
    }
    return progress;
  }

 private:
  mutable base::Mutex mutex_;
  std::vector<std::pair<std::string, Source>> sources_ ABSL_GUARDED_BY(mutex_);
};

struct Metrics {
  std::atomic<std::uint64_t> frames_processed{0};
  std::atomic<std::uint64_t> frames_dropped{0};
  std::atomic<std::uint64_t> frames_failed{0};
  std::atomic<std::uint64_t> sessions_created{0};
  std::atomic<std::uint64_t> sessions_expired{0};
  std::atomic<std::int64_t> sessions{0};     // now
  std::atomic<std::int64_t> streams{0};      // now
  std::atomic<std::int64_t> watchers{0};     // now
  std::atomic<std::int64_t> serving{0};      // 1 while new work is taken
  std::atomic<std::int64_t> stalled{0};      // 1 while work stands still
  std::atomic<std::int64_t> connections{0};  // of clients, now
  std::atomic<std::uint64_t> connections_over_limit{0};
  std::atomic<std::uint64_t> connections_ended{0};  // for what was half sent
  std::atomic<std::int64_t> calls{0};               // open now
  std::atomic<std::uint64_t> calls_over_limit{0};
  std::atomic<std::uint64_t> calls_unauthenticated{0};
  std::atomic<std::uint64_t> over_quota{0};    // calls and frames
  std::atomic<std::uint64_t> calls_denied{0};  // to callers without the scope
  std::atomic<std::uint64_t> maps_imported{0};
  std::atomic<std::uint64_t> map_imports_failed{0};
  std::atomic<std::int64_t> builds{0};  // of maps, now
  std::atomic<std::uint64_t> maps_built{0};
  std::atomic<std::uint64_t> map_builds_failed{0};
  std::atomic<std::uint64_t> images_localized{0};
  DurationHistogram queue;
  DurationHistogram decode;
  DurationHistogram localize;
  DurationHistogram track;
  DurationHistogram total;
  // What whoever looks after the store has last found, of all tenants.
  std::atomic<std::uint64_t> maps{0};
  std::atomic<std::uint64_t> map_versions{0};
  std::atomic<std::uint64_t> map_versions_removed{0};  // as they were old
  std::atomic<std::uint64_t> map_versions_in_use{0};   // although old
  QueueProgress queues;
  // Where spans go; null = nobody wants any. Set before the server starts.
  SpanQueue* spans = nullptr;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_METRICS_H_
