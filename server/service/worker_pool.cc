// SPDX-License-Identifier: Apache-2.0
#include "server/service/worker_pool.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <utility>

#include "map_store/base/process.h"

namespace groundlock::service {

std::shared_ptr<Strand> Strand::Create(WorkerPool* pool,
                                       std::function<bool()> step) {
  return std::shared_ptr<Strand>(new Strand(pool, std::move(step)));
}

Strand::Strand(WorkerPool* pool, std::function<bool()> step)
    : pool_(pool), step_(std::move(step)) {}

void Strand::Wake() {
  State state = state_.load(std::memory_order_relaxed);
  for (;;) {
    State next = State::kScheduled;
    if (state == State::kRunning) {
      next = State::kRunningAndWoken;
    } else if (state != State::kIdle) {
      // Already going to run. The exchange with itself orders the caller's
      // writes before that run.
      next = state;
    }
    if (state_.compare_exchange_weak(state, next, std::memory_order_acq_rel)) {
      break;
    }
  }
  if (state == State::kIdle) pool_->Schedule(shared_from_this());
}

void Strand::Run() {
  state_.exchange(State::kRunning, std::memory_order_acq_rel);
  const bool more = step_();
  State expected = State::kRunning;
  if (!more && state_.compare_exchange_strong(
                   expected, State::kIdle, std::memory_order_acq_rel)) {
    return;
  }
  state_.store(State::kScheduled, std::memory_order_release);
  pool_->Schedule(shared_from_this());
}

WorkerPool::WorkerPool(int num_threads, int max_strands)
    // Room for strands that are released but not yet out of the queue.
    : mask_(std::bit_ceil(2 *
                          static_cast<std::size_t>(std::max(max_strands, 8))) -
            1),
      slots_(std::make_unique<Slot[]>(mask_ + 1)) {
  for (std::size_t i = 0; i <= mask_; ++i) {
    slots_[i].turn.store(i, std::memory_order_relaxed);
  }
  sem_init(&ready_, /*pshared=*/0, 0);
  for (int i = 0; i < std::max(1, num_threads); ++i) {
    threads_.emplace_back([this] { Work(); });
  }
}

WorkerPool::~WorkerPool() {
  stopping_.store(true, std::memory_order_release);
  for (std::size_t i = 0; i < threads_.size(); ++i) sem_post(&ready_);
  for (std::thread& thread : threads_) thread.join();
  sem_destroy(&ready_);
}

void WorkerPool::Schedule(std::shared_ptr<Strand> strand) {
  while (!TryPush(strand)) std::this_thread::yield();
  sem_post(&ready_);
}

bool WorkerPool::TryPush(std::shared_ptr<Strand>& strand) {
  std::size_t turn = push_turn_.load(std::memory_order_relaxed);
  for (;;) {
    Slot& slot = slots_[turn & mask_];
    const auto difference = static_cast<std::ptrdiff_t>(
        slot.turn.load(std::memory_order_acquire) - turn);
    if (difference < 0) return false;  // full
    if (difference > 0) {
      turn = push_turn_.load(std::memory_order_relaxed);
    } else if (push_turn_.compare_exchange_weak(
                   turn, turn + 1, std::memory_order_relaxed)) {
      slot.strand = std::move(strand);
      slot.turn.store(turn + 1, std::memory_order_release);
      return true;
    }
  }
}

std::shared_ptr<Strand> WorkerPool::TryPop() {
  std::size_t turn = pop_turn_.load(std::memory_order_relaxed);
  for (;;) {
    Slot& slot = slots_[turn & mask_];
    const auto difference = static_cast<std::ptrdiff_t>(
        slot.turn.load(std::memory_order_acquire) - (turn + 1));
    if (difference < 0) return nullptr;  // empty
    if (difference > 0) {
      turn = pop_turn_.load(std::memory_order_relaxed);
    } else if (pop_turn_.compare_exchange_weak(
                   turn, turn + 1, std::memory_order_relaxed)) {
      std::shared_ptr<Strand> strand = std::move(slot.strand);
      slot.turn.store(turn + mask_ + 1, std::memory_order_release);
      return strand;
    }
  }
}

void WorkerPool::Work() {
  base::NameThisThread("gl-frames");
  for (;;) {
    while (sem_wait(&ready_) != 0 && errno == EINTR) {
    }
    std::shared_ptr<Strand> strand = TryPop();
    // A producer that has taken an earlier turn may not have stored its strand
    // yet although a later one has posted: it will be there in a moment.
    while (strand == nullptr && !stopping_.load(std::memory_order_acquire)) {
      std::this_thread::yield();
      strand = TryPop();
    }
    if (strand == nullptr) return;
    strand->Run();
  }
}

}  // namespace groundlock::service
