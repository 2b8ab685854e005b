// SPDX-License-Identifier: Apache-2.0
// Connections that are made when they are needed, and made anew when the
// database was away.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_POOL_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_POOL_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/storage/internal/postgres_connection.h"
#include "map_store/storage/store.h"

namespace groundlock::storage::internal {

// Repeats `attempt` while it returns kUnavailable or kAborted, for as long as a
// database takes to restart; then returns its last error.
absl::Status RetryWhileAway(const std::function<absl::Status()>& attempt);

// Thread-safe.
class PostgresPool {
 public:
  explicit PostgresPool(std::string url) : url_(std::move(url)) {}

  // Runs `body` with a connection of its own. Repeats it, from the beginning
  // and with another connection, as RetryWhileAway does.
  absl::Status Run(
      const std::function<absl::Status(PostgresConnection&)>& body);
  // The same without repeating.
  absl::Status RunOnce(
      const std::function<absl::Status(PostgresConnection&)>& body);
  // Sets the fields of `stats` that tell of the database.
  void FillStats(StoreStats& stats) const;

 private:
  absl::StatusOr<std::unique_ptr<PostgresConnection>> Take();
  void GiveBack(std::unique_ptr<PostgresConnection> connection);

  const std::string url_;
  std::atomic<std::uint64_t> made_{0};
  std::atomic<std::uint64_t> failed_{0};
  std::atomic<std::uint64_t> in_use_{0};
  std::atomic<std::uint64_t> away_{0};
  base::Mutex mutex_;
  std::vector<std::unique_ptr<PostgresConnection>> idle_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_POOL_H_
