// SPDX-License-Identifier: Apache-2.0
// What the server counts about itself. Lock-free, so that counting never makes
// one session wait for another; the program decides how to publish it.
#ifndef GROUNDLOCK_SERVER_SERVICE_METRICS_H_
#define GROUNDLOCK_SERVER_SERVICE_METRICS_H_

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>

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

struct Metrics {
  std::atomic<std::uint64_t> frames_processed{0};
  std::atomic<std::uint64_t> frames_dropped{0};
  std::atomic<std::uint64_t> frames_failed{0};
  std::atomic<std::uint64_t> sessions_created{0};
  std::atomic<std::uint64_t> sessions_expired{0};
  std::atomic<std::int64_t> sessions{0};  // now
  std::atomic<std::int64_t> streams{0};   // now
  std::atomic<std::int64_t> watchers{0};  // now
  std::atomic<std::int64_t> serving{0};   // 1 while new work is taken
  std::atomic<std::int64_t> stalled{0};   // 1 while work stands still
  std::atomic<std::uint64_t> calls_unauthenticated{0};
  std::atomic<std::uint64_t> calls_denied{0};  // to callers without the scope
  std::atomic<std::uint64_t> maps_imported{0};
  std::atomic<std::uint64_t> map_imports_failed{0};
  std::atomic<std::uint64_t> images_localized{0};
  DurationHistogram queue;
  DurationHistogram decode;
  DurationHistogram localize;
  DurationHistogram track;
  DurationHistogram total;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_METRICS_H_
