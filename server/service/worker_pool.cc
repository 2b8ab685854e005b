// SPDX-License-Identifier: Apache-2.0
#include "server/service/worker_pool.h"

#include <algorithm>
#include <cerrno>
#include <utility>

#include "map_store/base/process.h"

namespace groundlock::service {

std::shared_ptr<Strand> Strand::Create(WorkerPool* pool,
                                       std::function<bool()> step) {
  return std::shared_ptr<Strand>(new Strand(pool, std::move(step)));
}

Strand::Strand(WorkerPool* pool, std::function<bool()> step)
    : pool_(pool),
      step_(std::move(step)),
      unqueued_(1),
      place_(unqueued_.begin()) {}

void Strand::Wake() { pool_->Wake(*this); }

void Strand::Retire() { pool_->Retire(*this); }

WorkerPool::WorkerPool(int num_threads) {
  sem_init(&posted_, /*pshared=*/0, 0);
  for (int i = 0; i < std::max(1, num_threads); ++i) {
    threads_.emplace_back([this] { Work(); });
  }
}

WorkerPool::~WorkerPool() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  for (std::size_t i = 0; i < threads_.size(); ++i) sem_post(&posted_);
  for (std::thread& thread : threads_) thread.join();
  sem_destroy(&posted_);
}

Progress WorkerPool::progress() const {
  base::MutexLock lock(&mutex_);
  return {steps_done_, ready_.size()};
}

void WorkerPool::Queue(Strand& strand) {
  strand.state_ = Strand::State::kScheduled;
  *strand.place_ = strand.shared_from_this();
  ready_.splice(ready_.end(), strand.unqueued_);
}

void WorkerPool::Wake(Strand& strand) {
  {
    base::MutexLock lock(&mutex_);
    if (strand.state_ == Strand::State::kRunning) {
      strand.state_ = Strand::State::kRunningAndWoken;
    }
    if (strand.state_ != Strand::State::kIdle) return;
    Queue(strand);
  }
  sem_post(&posted_);
}

void WorkerPool::Retire(Strand& strand) {
  base::MutexLock lock(&mutex_);
  if (strand.state_ == Strand::State::kScheduled) {
    strand.unqueued_.splice(strand.unqueued_.end(), ready_, strand.place_);
    *strand.place_ = nullptr;  // the caller holds the strand, too
  }
  strand.state_ = Strand::State::kRetired;
}

std::shared_ptr<Strand> WorkerPool::Begin() {
  base::MutexLock lock(&mutex_);
  if (ready_.empty()) return nullptr;
  std::shared_ptr<Strand> strand = std::move(ready_.front());
  strand->unqueued_.splice(strand->unqueued_.end(), ready_, strand->place_);
  strand->state_ = Strand::State::kRunning;
  return strand;
}

bool WorkerPool::End(Strand& strand, bool more) {
  base::MutexLock lock(&mutex_);
  ++steps_done_;
  if (strand.state_ == Strand::State::kRetired) return false;
  if (!more && strand.state_ == Strand::State::kRunning) {
    strand.state_ = Strand::State::kIdle;
    return false;
  }
  Queue(strand);
  return true;
}

void WorkerPool::Work() {
  base::NameThisThread("gl-frames");
  for (;;) {
    while (sem_wait(&posted_) != 0 && errno == EINTR) {
    }
    const std::shared_ptr<Strand> strand = Begin();
    if (strand == nullptr) {
      base::MutexLock lock(&mutex_);
      if (stopping_) return;
      continue;
    }
    if (End(*strand, strand->step_())) sem_post(&posted_);
  }
}

}  // namespace groundlock::service
