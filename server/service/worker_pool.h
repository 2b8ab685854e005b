// SPDX-License-Identifier: Apache-2.0
// One pool of threads for all sessions, and strands on it: a strand's steps run
// one at a time and in order, on whichever worker is free.
#ifndef GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_
#define GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_

#include <semaphore.h>

#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "server/service/progress.h"

namespace groundlock::service {

class WorkerPool;

// Work that is done in turns, e.g. the frames of a session. Between two steps
// others get their turn.
class Strand : public std::enable_shared_from_this<Strand> {
 public:
  // step: does one unit of work (one frame) and returns whether there is more.
  // It must not throw.
  static std::shared_ptr<Strand> Create(WorkerPool* pool,
                                        std::function<bool()> step);
  // After it `step` runs at least once more. May be called from any thread and
  // never waits for work; without effect on a retired strand.
  void Wake();
  // For good: the strand leaves the pool's queue at once, and after a step that
  // is running no other one begins. The same holds of threads and waiting.
  void Retire();

 private:
  friend class WorkerPool;
  // Idle: not in the pool's queue. Scheduled: in it, once. Running: a worker is
  // in `step`; woken again meanwhile, it goes back into the queue.
  enum class State { kIdle, kScheduled, kRunning, kRunningAndWoken, kRetired };

  Strand(WorkerPool* pool, std::function<bool()> step);

  WorkerPool* const pool_;
  const std::function<bool()> step_;
  // The rest belongs to the pool's lock.
  State state_ = State::kIdle;
  // The strand's place in the queue, made once: queueing allocates nothing. It
  // lies in `unqueued_` or in the queue, where it holds the strand alive.
  std::list<std::shared_ptr<Strand>> unqueued_;
  const std::list<std::shared_ptr<Strand>>::iterator place_;
};

// The queue of strands that are ready has room for all of them: each is in it
// once at most. It is touched a few times per frame, under a lock that is held
// for some tens of nanoseconds; workers without work sleep.
class WorkerPool {
 public:
  explicit WorkerPool(int num_threads);
  // Finishes what is scheduled, then joins. Nothing may be woken any more.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int num_threads() const { return static_cast<int>(threads_.size()); }
  // Steps done, and strands that wait for a worker. Thread-safe.
  Progress progress() const;

 private:
  friend class Strand;

  void Wake(Strand& strand);
  void Retire(Strand& strand);
  void Queue(Strand& strand) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Null if none is ready.
  std::shared_ptr<Strand> Begin();
  // Returns whether the strand is in the queue again.
  bool End(Strand& strand, bool more);
  void Work();

  mutable base::Mutex mutex_;
  std::list<std::shared_ptr<Strand>> ready_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t steps_done_ ABSL_GUARDED_BY(mutex_) = 0;
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  // One count per strand that was queued, one per farewell. Strands that were
  // retired leave theirs behind, which costs a worker one look at the queue.
  sem_t posted_{};
  std::vector<std::thread> threads_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WORKER_POOL_H_
