// SPDX-License-Identifier: Apache-2.0
// A few threads for work beside the frames: disk, imports, single images.
#ifndef GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_
#define GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_

#include <deque>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "map_store/base/mutex.h"

namespace groundlock::service {

// Runs tasks in the order in which they were posted. Thread-safe.
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

 private:
  void Work(const std::string& name);

  const int max_waiting_;
  const Priority priority_;
  base::Mutex mutex_;
  std::deque<std::function<void()>> tasks_ ABSL_GUARDED_BY(mutex_);
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> threads_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_BACKGROUND_EXECUTOR_H_
