// SPDX-License-Identifier: Apache-2.0
#include "server/service/call_watch.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "map_store/base/process.h"

namespace groundlock::service {

CallWatch::CallWatch(std::chrono::nanoseconds interval)
    : interval_(interval), thread_([this] { Work(); }) {}

CallWatch::~CallWatch() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  thread_.join();
}

void CallWatch::Add(WatchedCall* call) {
  base::MutexLock lock(&mutex_);
  calls_.insert(call);
}

void CallWatch::Remove(WatchedCall* call) {
  base::MutexLock lock(&mutex_);
  calls_.erase(call);
}

void CallWatch::Work() {
  base::NameThisThread("gl-calls");
  base::MutexLock lock(&mutex_);
  for (;;) {
    const bool stop = mutex_.AwaitFor(
        interval_,
        [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return stopping_; });
    if (stop) return;
    const auto now = std::chrono::steady_clock::now();
    for (WatchedCall* call : calls_) call->OnTick(now);
  }
}

ReadDeadline::ReadDeadline(std::chrono::nanoseconds limit,
                           std::chrono::nanoseconds total)
    : limit_(limit),
      total_(total),
      end_(total == std::chrono::nanoseconds::max()
               ? std::chrono::steady_clock::time_point::max()
               : std::chrono::steady_clock::now() + total),
      credit_(limit) {}

absl::Status ReadDeadline::Why() const {
  const bool is_over = IsOver(std::chrono::steady_clock::now());
  return absl::DeadlineExceededError(absl::StrCat(
      is_over ? "sending took more than " : "the client sent too little for ",
      absl::FormatDuration(absl::FromChrono(is_over ? total_ : limit_))));
}

void ReadDeadline::Begin() {
  base::MutexLock lock(&mutex_);
  if (state_ == State::kExpired) return;
  state_ = State::kReading;
  begin_ = std::chrono::steady_clock::now();
}

bool ReadDeadline::End(std::size_t bytes) {
  base::MutexLock lock(&mutex_);
  if (state_ == State::kExpired) return false;
  state_ = State::kIdle;
  const std::chrono::duration<double> earned(static_cast<double>(bytes) /
                                             kMinBytesPerSecond);
  credit_ -= std::chrono::steady_clock::now() - begin_;
  credit_ = std::min(
      limit_,
      credit_ + std::chrono::duration_cast<std::chrono::nanoseconds>(earned));
  return true;
}

bool ReadDeadline::Expire(std::chrono::steady_clock::time_point now) {
  base::MutexLock lock(&mutex_);
  if (state_ != State::kReading) return false;
  if (now - begin_ <= credit_ && !IsOver(now)) return false;
  state_ = State::kExpired;
  return true;
}

}  // namespace groundlock::service
