// SPDX-License-Identifier: Apache-2.0
// The tables in a PostgreSQL database, and how those of older versions become
// ours.
//
// A map's file lies in rows of 1 MiB (groundlock.chunks) rather than in a large
// object: rows belong to their map by a foreign key, so that a delete is one
// statement and nothing can be orphaned (large objects need vacuumlo); they are
// under the same privileges as all tables; and logical replication carries
// them. What large objects would add, seeking and writing in place, immutable
// files do not need.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_SCHEMA_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_SCHEMA_H_

#include <cstdint>

#include "absl/status/status.h"
#include "map_store/storage/internal/postgres_connection.h"

namespace groundlock::storage::internal {

// Of every chunk of a map's file but the last.
inline constexpr std::uint64_t kPostgresChunkBytes = 1 << 20;

// Creates the tables if they are absent, or brings older ones up to date; all
// or nothing. kUnimplemented: a newer program made them. kPermissionDenied says
// which right is missing.
absl::Status PreparePostgresSchema(PostgresConnection& connection);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_SCHEMA_H_
