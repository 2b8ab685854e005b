// SPDX-License-Identifier: Apache-2.0
// Calls whose clients say nothing do not last for ever.
#ifndef GROUNDLOCK_SERVER_SERVICE_CALL_WATCH_H_
#define GROUNDLOCK_SERVER_SERVICE_CALL_WATCH_H_

#include <chrono>
#include <cstddef>
#include <set>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "map_store/base/mutex.h"

namespace groundlock::service {

// A call that is looked at now and then.
class WatchedCall {
 public:
  virtual void OnTick(std::chrono::steady_clock::time_point now) = 0;

 protected:
  ~WatchedCall() = default;
};

// Looks at calls from a thread of its own. Thread-safe.
class CallWatch {
 public:
  explicit CallWatch(std::chrono::nanoseconds interval);
  ~CallWatch();
  CallWatch(const CallWatch&) = delete;
  CallWatch& operator=(const CallWatch&) = delete;

  void Add(WatchedCall* call);
  // After it `call` is not looked at any more, nor being looked at. Not from
  // OnTick.
  void Remove(WatchedCall* call);

 private:
  void Work();

  const std::chrono::nanoseconds interval_;
  base::Mutex mutex_;
  std::set<WatchedCall*> calls_ ABSL_GUARDED_BY(mutex_);
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

// How long a call waits for its client's next message, or for its client to
// take one. A client has `limit` of waiting on credit; what it sends earns
// credit back, so that one that sends a byte now and then is not waited for
// either. Thread-safe: whoever reads calls Begin and End, whoever watches calls
// Expire; one of End and Expire is told that the read is over.
class ReadDeadline {
 public:
  // Slower than any line that could carry a video, or an upload of photos.
  static constexpr double kMinBytesPerSecond = 4096.0;
  // As End's bytes: all credit is back, so that each wait is looked at alone.
  static constexpr std::size_t kAllBack = std::size_t{1} << 40;

  // total: what all reads may last together, however much comes.
  explicit ReadDeadline(
      std::chrono::nanoseconds limit,
      std::chrono::nanoseconds total = std::chrono::nanoseconds::max());

  void Begin();
  // False if the read had expired.
  bool End(std::size_t bytes);
  // True if the read under way has lasted for too long; once.
  bool Expire(std::chrono::steady_clock::time_point now);
  // Whether all that was given has passed, reading or not.
  bool IsOver(std::chrono::steady_clock::time_point now) const {
    return now > end_;
  }
  // Why it expired: kDeadlineExceeded.
  absl::Status Why() const;

 private:
  enum class State { kIdle, kReading, kExpired };
  const std::chrono::nanoseconds limit_;
  const std::chrono::nanoseconds total_;
  const std::chrono::steady_clock::time_point end_;
  base::Mutex mutex_;
  State state_ ABSL_GUARDED_BY(mutex_) = State::kIdle;
  std::chrono::nanoseconds credit_ ABSL_GUARDED_BY(mutex_);
  std::chrono::steady_clock::time_point begin_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_CALL_WATCH_H_
