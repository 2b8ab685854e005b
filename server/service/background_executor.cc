// SPDX-License-Identifier: Apache-2.0
#include "server/service/background_executor.h"

#include <sys/resource.h>

#include <exception>
#include <utility>

#include "map_store/base/process.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

namespace {

// A frame wants a core for some milliseconds of its 40; what is left over is
// mostly enough for the rest. A thirtieth of a busy core is still theirs, so
// that a camera is anchored in the end, and a thread which is put off while it
// holds a lock comes back.
constexpr int kLowerBy = 15;

}  // namespace

BackgroundExecutor::BackgroundExecutor(const std::string& name,
                                       int num_threads,
                                       int max_waiting,
                                       Priority priority)
    : name_(name), max_waiting_(max_waiting), priority_(priority) {
  for (int i = 0; i < num_threads; ++i) {
    threads_.emplace_back([this] { Work(); });
  }
}

BackgroundExecutor::~BackgroundExecutor() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  for (std::thread& thread : threads_) thread.join();
}

absl::Status BackgroundExecutor::TryPost(std::function<void()> task) {
  base::MutexLock lock(&mutex_);
  if (static_cast<int>(tasks_.size()) >= max_waiting_) {
    return absl::ResourceExhaustedError(
        "the server is busy with other imports and images; try again later");
  }
  tasks_.push_back(std::move(task));
  return absl::OkStatus();
}

void BackgroundExecutor::Post(std::function<void()> task) {
  base::MutexLock lock(&mutex_);
  tasks_.push_back(std::move(task));
}

Progress BackgroundExecutor::progress() const {
  base::MutexLock lock(&mutex_);
  return {done_, tasks_.size()};
}

// What a task throws concerns that task: memory that is missing for one anchor
// does not end the sessions of others.
void BackgroundExecutor::Run(std::function<void()> task) {
  try {
    task();
  } catch (const std::exception& error) {
    spdlog::error("{}: a task failed: {}", name_, error.what());
  } catch (...) {
    spdlog::error("{}: a task failed", name_);
  }
}

void BackgroundExecutor::Work() {
  base::NameThisThread(name_);
#ifdef __linux__
  // On Linux this is the thread's own (nice(2)). Refusal costs only time.
  if (priority_ == Priority::kLow) {
    const int normal = getpriority(PRIO_PROCESS, 0);
    static_cast<void>(setpriority(PRIO_PROCESS, 0, normal + kLowerBy));
  }
#endif
  for (;;) {
    std::function<void()> task;
    {
      base::MutexLock lock(&mutex_);
      mutex_.Await([this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
        return stopping_ || !tasks_.empty();
      });
      if (tasks_.empty()) return;
      task = std::move(tasks_.front());
      tasks_.pop_front();
    }
    Run(std::move(task));
    base::MutexLock lock(&mutex_);
    ++done_;
  }
}

}  // namespace groundlock::service
