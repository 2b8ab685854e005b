// SPDX-License-Identifier: Apache-2.0
// A map's file as rows of chunks.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONTENT_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONTENT_H_

#include <cstdint>
#include <filesystem>

#include "absl/status/status.h"
#include "map_store/storage/internal/postgres_connection.h"

namespace groundlock::storage::internal {

// Both inside a transaction; at most a chunk is held in memory at a time.
absl::Status InsertContent(PostgresConnection& connection,
                           std::int64_t map_id,
                           const std::filesystem::path& file);
// kDataLoss unless the chunks add up to `bytes`.
absl::Status FetchContent(PostgresConnection& connection,
                          std::int64_t map_id,
                          std::uint64_t bytes,
                          const std::filesystem::path& file);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONTENT_H_
