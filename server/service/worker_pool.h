// SPDX-License-Identifier: Apache-2.0
// One pool of threads for all sessions, and strands on it: a strand's steps run
// one at a time and in order, on whichever worker is free.
#ifndef GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_
#define GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_

#include <semaphore.h>

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

namespace groundlock::service {

class WorkerPool;

// Work that is done in turns, e.g. the frames of a session. Wake() may be
// called from any thread and never blocks; after it, `step` runs at least once
// more. Between two steps others get their turn.
class Strand : public std::enable_shared_from_this<Strand> {
 public:
  // step: does one unit of work (one frame) and returns whether there is more.
  // It must not throw.
  static std::shared_ptr<Strand> Create(WorkerPool* pool,
                                        std::function<bool()> step);
  void Wake();

 private:
  friend class WorkerPool;
  // Idle: not in the pool's queue. Scheduled: in it, once. Running: a worker is
  // in `step`; woken again meanwhile, it goes back into the queue.
  enum class State { kIdle, kScheduled, kRunning, kRunningAndWoken };

  Strand(WorkerPool* pool, std::function<bool()> step);
  void Run();

  WorkerPool* const pool_;
  const std::function<bool()> step_;
  std::atomic<State> state_{State::kIdle};
};

// The queue of strands that are ready is lock-free, so that no session holds a
// lock that another one's frame needs; workers without work sleep.
class WorkerPool {
 public:
  // max_strands: strands that may exist at a time (they are queued once each).
  WorkerPool(int num_threads, int max_strands);
  // Finishes what is scheduled, then joins. Nothing may be woken any more.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int num_threads() const { return static_cast<int>(threads_.size()); }

 private:
  friend class Strand;
  // A slot of a bounded queue of many producers and many consumers; `turn` says
  // whose turn it is. Source: D. Vyukov, "Bounded MPMC queue", 2010.
  struct alignas(64) Slot {
    std::atomic<std::size_t> turn;
    std::shared_ptr<Strand> strand;
  };

  void Schedule(std::shared_ptr<Strand> strand);
  bool TryPush(std::shared_ptr<Strand>& strand);
  std::shared_ptr<Strand> TryPop();
  void Work();

  const std::size_t mask_;  // number of slots, a power of two, minus one
  const std::unique_ptr<Slot[]> slots_;
  alignas(64) std::atomic<std::size_t> push_turn_{0};
  alignas(64) std::atomic<std::size_t> pop_turn_{0};
  alignas(64) sem_t ready_{};  // one count per strand queued, one per farewell
  std::atomic<bool> stopping_{false};
  std::vector<std::thread> threads_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_
