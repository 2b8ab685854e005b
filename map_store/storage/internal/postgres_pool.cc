// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_pool.h"

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

using std::chrono::milliseconds;

// A restart takes seconds; whoever waits for a map has not much more patience.
constexpr milliseconds kRetryFor(15'000);
constexpr milliseconds kFirstPause(50);
constexpr milliseconds kLongestPause(1'000);

constexpr std::size_t kMaxIdle = 4;

}  // namespace

absl::Status RetryWhileAway(const std::function<absl::Status()>& attempt) {
  const auto end = std::chrono::steady_clock::now() + kRetryFor;
  milliseconds pause = kFirstPause;
  for (;;) {
    absl::Status status = attempt();
    const bool again = absl::IsUnavailable(status) || absl::IsAborted(status);
    if (!again || std::chrono::steady_clock::now() + pause > end) {
      return status;
    }
    std::this_thread::sleep_for(pause);
    pause = std::min(2 * pause, kLongestPause);
  }
}

absl::StatusOr<std::unique_ptr<PostgresConnection>> PostgresPool::Take() {
  {
    base::MutexLock lock(&mutex_);
    if (!idle_.empty()) {
      auto connection = std::move(idle_.back());
      idle_.pop_back();
      return connection;
    }
  }
  return PostgresConnection::Connect(url_);
}

void PostgresPool::GiveBack(std::unique_ptr<PostgresConnection> connection) {
  // Those that are let go are closed after the lock is released.
  std::vector<std::unique_ptr<PostgresConnection>> closed;
  base::MutexLock lock(&mutex_);
  if (connection->IsAlive()) {
    if (idle_.size() < kMaxIdle) idle_.push_back(std::move(connection));
  } else {
    // If one is lost, the others have been idle through the same.
    closed.swap(idle_);
  }
}

absl::Status PostgresPool::RunOnce(
    const std::function<absl::Status(PostgresConnection&)>& body) {
  ASSIGN_OR_RETURN(auto connection, Take());
  const absl::Status status = body(*connection);
  GiveBack(std::move(connection));
  return status;
}

absl::Status PostgresPool::Run(
    const std::function<absl::Status(PostgresConnection&)>& body) {
  return RetryWhileAway([&] { return RunOnce(body); });
}

}  // namespace groundlock::storage::internal
