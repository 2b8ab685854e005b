// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_CLI_INTERRUPT_H_
#define GROUNDLOCK_CLIENT_CLI_INTERRUPT_H_

#include <atomic>
#include <functional>
#include <mutex>
#include <thread>

namespace groundlock::cli {

// Turns Ctrl-C (SIGINT) and SIGTERM into a flag and a call, so that a verb can
// finish its files and its session. A second signal ends the program at once
// with status 130. Signals are received by a thread of its own rather than in a
// handler: no global state, and the callback may do anything.
//
// Make the one instance before any other thread starts: threads inherit the
// signal mask that it sets. Thread-safe.
class Interrupt {
 public:
  Interrupt();
  Interrupt(const Interrupt&) = delete;
  Interrupt& operator=(const Interrupt&) = delete;
  ~Interrupt();

  bool interrupted() const { return interrupted_.load(); }
  // Called once, from a thread of ours, after the first signal; at once if
  // there has been one. An empty function clears it: no call is running or will
  // come after that. The callback must not call OnInterrupt.
  void OnInterrupt(std::function<void()> callback);

 private:
  void Run();
  void Call();  // with mutex_ held

  std::atomic<bool> interrupted_ = false;
  std::atomic<bool> stop_ = false;
  std::mutex mutex_;
  std::function<void()> callback_;
  std::thread caller_;
  std::thread thread_;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_INTERRUPT_H_
