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
  auto connection = PostgresConnection::Connect(url_);
  ++(connection.ok() ? made_ : failed_);
  return connection;
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
  auto connection = Take();
  absl::Status status = connection.status();
  if (status.ok()) {
    ++in_use_;
    status = body(**connection);
    --in_use_;
    GiveBack(*std::move(connection));
  }
  if (absl::IsUnavailable(status)) ++away_;
  return status;
}

void PostgresPool::FillStats(StoreStats& stats) const {
  stats.connections_made = made_;
  stats.connections_failed = failed_;
  stats.connections_in_use = in_use_;
  stats.database_away = away_;
}

absl::Status PostgresPool::Run(
    const std::function<absl::Status(PostgresConnection&)>& body) {
  return RetryWhileAway([&] { return RunOnce(body); });
}

}  // namespace groundlock::storage::internal
