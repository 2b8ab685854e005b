// SPDX-License-Identifier: Apache-2.0
// Which maps this process has open, told to all others on the database by
// shared advisory locks: they end with the connection, however that ends.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_PINS_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_PINS_H_

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/storage/internal/postgres_connection.h"

namespace groundlock::storage::internal {

// First key of our advisory locks, "GLMS"; the second is a map's id, or 0 for
// the schema.
inline constexpr std::int64_t kPostgresLockSpace = 0x474C4D53;

// Thread-safe. If the connection was lost, the pins are renewed on the next
// one; a garbage collection in between may remove a pinned map.
class PostgresPins {
 public:
  // A map's lock; given back on destruction, or a little later.
  class Pin;

  explicit PostgresPins(std::string url);
  ~PostgresPins();

  // Waits for a garbage collection that is removing this very map.
  absl::StatusOr<std::shared_ptr<Pin>> Take(std::int64_t map_id);
  // Gives back, and renews, what is due. Does not wait for a lost database.
  absl::Status Refresh();

 private:
  struct State;

  const std::string url_;
  const std::shared_ptr<State> state_;  // pins may outlive the store
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_PINS_H_
