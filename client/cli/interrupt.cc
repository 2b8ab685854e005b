// SPDX-License-Identifier: Apache-2.0
#include "client/cli/interrupt.h"

#include <signal.h>
#include <unistd.h>

#include <ctime>
#include <utility>

namespace groundlock::cli {
namespace {

sigset_t Signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  return signals;
}

}  // namespace

Interrupt::Interrupt() {
  const sigset_t signals = Signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  thread_ = std::thread([this] { Run(); });
}

Interrupt::~Interrupt() {
  stop_ = true;
  thread_.join();
  if (caller_.joinable()) caller_.join();
  const sigset_t signals = Signals();
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
}

void Interrupt::OnInterrupt(std::function<void()> callback) {
  const std::lock_guard lock(mutex_);
  callback_ = std::move(callback);
  if (interrupted_) Call();
}

void Interrupt::Call() {
  if (const auto callback = std::exchange(callback_, nullptr)) callback();
}

void Interrupt::Run() {
  const sigset_t signals = Signals();
  // Waits in short turns, so that the destructor is not held up.
  const timespec turn{.tv_sec = 0, .tv_nsec = 50'000'000};
  while (!stop_) {
    if (sigtimedwait(&signals, nullptr, &turn) <= 0) continue;
    if (interrupted_.exchange(true)) _exit(130);
    // Apart from this thread, so that it can see the second signal while the
    // callback works.
    caller_ = std::thread([this] {
      const std::lock_guard lock(mutex_);
      Call();
    });
  }
}

}  // namespace groundlock::cli
