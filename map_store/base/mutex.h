// SPDX-License-Identifier: Apache-2.0
// A mutex that the thread sanitizer understands. Debian's absl::Mutex is built
// without its annotations, so everything guarded by one looks like a race;
// std::mutex is seen, but has no annotations for clang's -Wthread-safety.
#ifndef GROUNDLOCK_MAP_STORE_BASE_MUTEX_H_
#define GROUNDLOCK_MAP_STORE_BASE_MUTEX_H_

#include <chrono>
#include <condition_variable>
#include <mutex>

#include "absl/base/thread_annotations.h"

namespace groundlock::base {

class ABSL_LOCKABLE Mutex {
 public:
  void Lock() ABSL_EXCLUSIVE_LOCK_FUNCTION() { mutex_.lock(); }
  void Unlock() ABSL_UNLOCK_FUNCTION() {
    // Under the lock: whoever it wakes may destroy the mutex once it is free.
    if (waiting_ > 0) changed_.notify_all();
    mutex_.unlock();
  }

  // Tells the analysis, which does not look through calls of lambdas.
  void AssertHeld() const ABSL_ASSERT_EXCLUSIVE_LOCK() {}

  // Waits, unlocked meanwhile, until `condition()` holds. Whatever it looks at
  // must be changed under this mutex.
  template <typename Condition>
  void Await(Condition condition)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(this) ABSL_NO_THREAD_SAFETY_ANALYSIS {
    std::unique_lock<std::mutex> lock(mutex_, std::adopt_lock);
    ++waiting_;
    changed_.wait(lock, condition);
    --waiting_;
    lock.release();
  }
  // As Await, but no longer than `timeout`. Returns condition().
  template <typename Condition>
  bool AwaitFor(std::chrono::nanoseconds timeout, Condition condition)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(this) ABSL_NO_THREAD_SAFETY_ANALYSIS {
    std::unique_lock<std::mutex> lock(mutex_, std::adopt_lock);
    ++waiting_;
    const bool holds = changed_.wait_for(lock, timeout, condition);
    --waiting_;
    lock.release();
    return holds;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  int waiting_ = 0;
};

class ABSL_SCOPED_LOCKABLE MutexLock {
 public:
  explicit MutexLock(Mutex* mutex) ABSL_EXCLUSIVE_LOCK_FUNCTION(mutex)
      : mutex_(mutex) {
    mutex_->Lock();
  }
  ~MutexLock() ABSL_UNLOCK_FUNCTION() { mutex_->Unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex* const mutex_;
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_MUTEX_H_
