// SPDX-License-Identifier: Apache-2.0
// The rows of maps and of their content in a PostgreSQL database.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CATALOGUE_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CATALOGUE_H_

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/storage/internal/postgres_connection.h"
#include "map_store/storage/store.h"

namespace groundlock::storage::internal {

struct PostgresEntry {
  std::int64_t id = 0;  // of the version's row; never used again
  MapVersion map;
};

// The newest version of each map, by name.
absl::StatusOr<std::vector<PostgresEntry>> SelectNewest(
    PostgresConnection& connection);
// All versions of a map, newest first; empty if there is none.
absl::StatusOr<std::vector<PostgresEntry>> SelectVersions(
    PostgresConnection& connection, std::string_view name);
absl::StatusOr<bool> MapExists(PostgresConnection& connection, std::int64_t id);

// Inside a transaction: writes the file's content and the row; sets the
// version, which is not that of any earlier map. Returns the row's id.
absl::StatusOr<std::int64_t> InsertMap(PostgresConnection& connection,
                                       const std::filesystem::path& file,
                                       MapVersion& map);
// How many versions there were.
absl::StatusOr<std::uint64_t> DeleteMaps(PostgresConnection& connection,
                                         std::string_view name);
// Inside a transaction: removes versions as of Store::CollectGarbage.
absl::StatusOr<GarbageReport> DeleteOldMaps(PostgresConnection& connection,
                                            std::uint64_t keep_newest);

// Sets num_maps and num_versions.
absl::Status CountMaps(PostgresConnection& connection, GarbageReport& report);

// Writes the content to a new file, synced. kNotFound if the map is not there
// any more; kDataLoss if the size differs from what the catalogue says.
absl::Status FetchMap(PostgresConnection& connection,
                      const PostgresEntry& entry,
                      const std::filesystem::path& file);

// What became of a transaction whose COMMIT was not answered. Waits while it is
// still under way.
absl::StatusOr<bool> WasCommitted(PostgresConnection& connection,
                                  std::int64_t transaction);
absl::StatusOr<std::int64_t> CurrentTransaction(PostgresConnection& connection);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CATALOGUE_H_
