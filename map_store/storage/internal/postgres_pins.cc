// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_pins.h"

#include <utility>

#include "map_store/base/status.h"
#include "map_store/storage/internal/postgres_pool.h"

namespace groundlock::storage::internal {
namespace {

constexpr PostgresStatement kLock = {
    "pin", "SELECT pg_advisory_lock_shared($1::int, $2::int)"};
constexpr PostgresStatement kUnlock = {
    "unpin", "SELECT pg_advisory_unlock_shared($1::int, $2::int)"};

PostgresParameters LockOf(std::int64_t map_id) {
  return PostgresParameters().Add(kPostgresLockSpace).Add(map_id);
}

}  // namespace

// Two locks: a pin that ends takes only the second, which nobody holds while
// waiting for the database.
struct PostgresPins::State {
  // Makes the connection if there is none that lives; then settles what is due.
  absl::Status Settle(const std::string& url)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex);

  base::Mutex mutex;
  std::unique_ptr<PostgresConnection> connection ABSL_GUARDED_BY(mutex);

  base::Mutex list_mutex;
  std::int64_t generation ABSL_GUARDED_BY(list_mutex) = 0;  // of connection
  std::map<std::int64_t, std::weak_ptr<Pin>> pins ABSL_GUARDED_BY(list_mutex);
  std::vector<std::int64_t> released ABSL_GUARDED_BY(list_mutex);
};

class PostgresPins::Pin {
 public:
  Pin(std::shared_ptr<State> state, std::int64_t map_id)
      : state_(std::move(state)), map_id_(map_id) {}
  ~Pin() {
    base::MutexLock lock(&state_->list_mutex);
    // A lock of a connection that is gone went with it.
    if (generation == state_->generation) {
      state_->released.push_back(map_id_);
    }
  }
  Pin(const Pin&) = delete;
  Pin& operator=(const Pin&) = delete;

  std::int64_t generation = 0;  // guarded by the state's list_mutex

 private:
  const std::shared_ptr<State> state_;
  const std::int64_t map_id_;
};

absl::Status PostgresPins::State::Settle(const std::string& url) {
  std::vector<std::int64_t> unlock;
  // Holds what it renews: a pin does not end before its lock is made.
  std::vector<std::pair<std::int64_t, std::shared_ptr<Pin>>> renew;
  if (connection == nullptr || !connection->IsAlive()) {
    connection = nullptr;
    ASSIGN_OR_RETURN(connection, PostgresConnection::Connect(url));
    base::MutexLock lock(&list_mutex);
    ++generation;
    released.clear();
    for (const auto& [id, weak] : pins) {
      if (auto pin = weak.lock()) renew.emplace_back(id, std::move(pin));
    }
  } else {
    base::MutexLock lock(&list_mutex);
    unlock.swap(released);
    std::erase_if(pins, [](const auto& item) { return item.second.expired(); });
  }
  for (const std::int64_t id : unlock) {
    RETURN_IF_ERROR(connection->Run(kUnlock, LockOf(id)).status());
  }
  for (const auto& [id, pin] : renew) {
    RETURN_IF_ERROR(connection->Run(kLock, LockOf(id)).status());
    base::MutexLock lock(&list_mutex);
    pin->generation = generation;
  }
  return absl::OkStatus();
}

PostgresPins::PostgresPins(std::string url)
    : url_(std::move(url)), state_(std::make_shared<State>()) {}

PostgresPins::~PostgresPins() {
  base::MutexLock lock(&state_->mutex);
  state_->connection = nullptr;  // and with it all locks
}

absl::StatusOr<std::shared_ptr<PostgresPins::Pin>> PostgresPins::Take(
    std::int64_t map_id) {
  std::shared_ptr<Pin> pin;
  const absl::Status status = RetryWhileAway([&]() -> absl::Status {
    State& state = *state_;
    base::MutexLock lock(&state.mutex);
    RETURN_IF_ERROR(state.Settle(url_));
    {
      base::MutexLock list_lock(&state.list_mutex);
      if (const auto found = state.pins.find(map_id);
          found != state.pins.end() && (pin = found->second.lock())) {
        return absl::OkStatus();
      }
    }
    RETURN_IF_ERROR(state.connection->Run(kLock, LockOf(map_id)).status());
    auto made = std::make_shared<Pin>(state_, map_id);
    base::MutexLock list_lock(&state.list_mutex);
    made->generation = state.generation;
    state.pins[map_id] = made;
    pin = std::move(made);
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  return pin;
}

absl::Status PostgresPins::Refresh() {
  base::MutexLock lock(&state_->mutex);
  // Only an answer tells that a connection is not lost.
  if (state_->connection != nullptr) {
    state_->connection->Execute("SELECT 1").IgnoreError();
  }
  return state_->Settle(url_);
}

}  // namespace groundlock::storage::internal
