// SPDX-License-Identifier: Apache-2.0
// A few threads for work beside the frames: disk, imports, single images.
#ifndef GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_
#define GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "map_store/base/mutex.h"
#include "server/service/progress.h"

namespace groundlock::service {

// Runs tasks in the order in which they were posted. A task that throws is
// logged and forgotten: what it held goes, and the thread takes the next one.
// Thread-safe.
class BackgroundExecutor {
 public:
  enum class Priority {
    kNormal,
    kLow,  // gives way to frames where both want a core
  };

  //   name  of its threads, in at most 15 characters.
  BackgroundExecutor(const std::string& name,
                     int num_threads,
                     int max_waiting,
                     Priority priority = Priority::kNormal);
  // Runs what is waiting, then joins.
  ~BackgroundExecutor();
  BackgroundExecutor(const BackgroundExecutor&) = delete;
  BackgroundExecutor& operator=(const BackgroundExecutor&) = delete;

  // For work that opens something new: kResourceExhausted when too much waits.
  absl::Status TryPost(std::function<void()> task);
  // For the next step of work under way; its number is bounded by that work.
  void Post(std::function<void()> task);
  // Tasks done, and those that wait for a thread.
  Progress progress() const;

 private:
  void Work();
  void Run(std::function<void()> task);

  const std::string name_;

  const int max_waiting_;
  const Priority priority_;
  mutable base::Mutex mutex_;
  std::uint64_t done_ ABSL_GUARDED_BY(mutex_) = 0;
  std::deque<std::function<void()>> tasks_ ABSL_GUARDED_BY(mutex_);
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> threads_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_
