// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_catalogue.h"

#include <chrono>
#include <string>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/backends.h"
#include "map_store/storage/internal/map_info_json.h"
#include "map_store/storage/internal/postgres_content.h"
#include "map_store/storage/internal/postgres_pins.h"

namespace groundlock::storage::internal {
namespace {

constexpr PostgresStatement kNewest = {
    "newest",
    "SELECT DISTINCT ON (name) id, name, version, created_ns, info "
    "FROM groundlock.maps ORDER BY name, version DESC"};
constexpr PostgresStatement kVersions = {
    "versions",
    "SELECT id, name, version, created_ns, info FROM groundlock.maps "
    "WHERE name = $1 ORDER BY version DESC"};
constexpr PostgresStatement kExists = {
    "exists", "SELECT EXISTS (SELECT FROM groundlock.maps WHERE id = $1::int)"};
constexpr PostgresStatement kTakeId = {
    "take_id",
    "SELECT nextval(pg_get_serial_sequence('groundlock.maps', 'id'))"};
constexpr PostgresStatement kTakeVersion = {
    "take_version",
    "INSERT INTO groundlock.names VALUES ($1, 1) ON CONFLICT (name) "
    "DO UPDATE SET last_version = names.last_version + 1 "
    "RETURNING last_version"};
constexpr PostgresStatement kInsert = {
    "insert",
    "INSERT INTO groundlock.maps (id, name, version, created_ns, info) "
    "OVERRIDING SYSTEM VALUE "
    "VALUES ($1::int, $2, $3::bigint, $4::bigint, $5::json)"};
constexpr PostgresStatement kDelete = {
    "delete", "DELETE FROM groundlock.maps WHERE name = $1"};
constexpr PostgresStatement kOld = {
    "old",
    "SELECT id FROM (SELECT id, row_number() OVER (PARTITION BY name ORDER BY "
    "version DESC) AS age FROM groundlock.maps) AS m WHERE age > $1::bigint"};
// Fails while anybody has the map open, and holds back whoever wants to.
constexpr PostgresStatement kTryLock = {
    "try_lock", "SELECT pg_try_advisory_xact_lock($1::int, $2::int)"};
constexpr PostgresStatement kDeleteOne = {
    "delete_one", "DELETE FROM groundlock.maps WHERE id = $1::int"};
constexpr PostgresStatement kCount = {
    "count", "SELECT count(DISTINCT name), count(*) FROM groundlock.maps"};
constexpr PostgresStatement kTransaction = {"transaction",
                                            "SELECT pg_current_xact_id()"};
constexpr PostgresStatement kOutcome = {"outcome",
                                        "SELECT pg_xact_status($1::xid8)"};

absl::StatusOr<std::vector<PostgresEntry>> ReadEntries(
    const PostgresResult& result) {
  std::vector<PostgresEntry> entries;
  for (int row = 0; row < result.num_rows(); ++row) {
    PostgresEntry& entry = entries.emplace_back();
    ASSIGN_OR_RETURN(entry.id, result.Integer(row, 0));
    entry.map.name = result.Text(row, 1);
    ASSIGN_OR_RETURN(const std::int64_t version, result.Integer(row, 2));
    entry.map.version = static_cast<std::uint64_t>(version);
    ASSIGN_OR_RETURN(const std::int64_t created_ns, result.Integer(row, 3));
    entry.map.created = std::chrono::system_clock::time_point(
        std::chrono::duration_cast<std::chrono::system_clock::duration>(
            std::chrono::nanoseconds(created_ns)));
    auto info = MapInfoFromJson(result.Text(row, 4));
    if (!info.ok()) {
      return base::Annotate(
          info.status(),
          absl::StrCat("map '", entry.map.name, "' version ", version));
    }
    entry.map.info = *std::move(info);
  }
  return entries;
}

}  // namespace

absl::StatusOr<std::vector<PostgresEntry>> SelectNewest(
    PostgresConnection& connection) {
  ASSIGN_OR_RETURN(const PostgresResult result, connection.Run(kNewest));
  return ReadEntries(result);
}

absl::StatusOr<std::vector<PostgresEntry>> SelectVersions(
    PostgresConnection& connection, std::string_view name) {
  ASSIGN_OR_RETURN(const PostgresResult result,
                   connection.Run(kVersions, PostgresParameters().Add(name)));
  return ReadEntries(result);
}

absl::StatusOr<bool> MapExists(PostgresConnection& connection,
                               std::int64_t id) {
  ASSIGN_OR_RETURN(const PostgresResult result,
                   connection.Run(kExists, PostgresParameters().Add(id)));
  return result.Boolean(0, 0);
}

absl::StatusOr<std::int64_t> InsertMap(PostgresConnection& connection,
                                       const std::filesystem::path& file,
                                       MapVersion& map) {
  ASSIGN_OR_RETURN(const PostgresResult id_row, connection.Run(kTakeId));
  ASSIGN_OR_RETURN(const std::int64_t id, id_row.Integer(0, 0));
  RETURN_IF_ERROR(InsertContent(connection, id, file));
  // Last: from here on, others that publish under this name wait.
  ASSIGN_OR_RETURN(
      const PostgresResult version_row,
      connection.Run(kTakeVersion, PostgresParameters().Add(map.name)));
  ASSIGN_OR_RETURN(const std::int64_t version, version_row.Integer(0, 0));
  map.version = static_cast<std::uint64_t>(version);
  RETURN_IF_ERROR(
      connection
          .Run(kInsert,
               PostgresParameters()
                   .Add(id)
                   .Add(map.name)
                   .Add(version)
                   .Add(std::int64_t{
                       std::chrono::duration_cast<std::chrono::nanoseconds>(
                           map.created.time_since_epoch())
                           .count()})
                   .Add(MapInfoToJson(map.info)))
          .status());
  return id;
}

absl::StatusOr<std::uint64_t> DeleteMaps(PostgresConnection& connection,
                                         std::string_view name) {
  ASSIGN_OR_RETURN(const PostgresResult result,
                   connection.Run(kDelete, PostgresParameters().Add(name)));
  return result.num_affected();
}

absl::StatusOr<GarbageReport> DeleteOldMaps(PostgresConnection& connection,
                                            std::uint64_t keep_newest) {
  GarbageReport report;
  ASSIGN_OR_RETURN(const PostgresResult old,
                   connection.Run(kOld, PostgresParameters().Add(keep_newest)));
  for (int row = 0; row < old.num_rows(); ++row) {
    ASSIGN_OR_RETURN(const std::int64_t id, old.Integer(row, 0));
    ASSIGN_OR_RETURN(
        const PostgresResult locked,
        connection.Run(kTryLock,
                       PostgresParameters().Add(kPostgresLockSpace).Add(id)));
    if (!locked.Boolean(0, 0)) {
      ++report.num_in_use;
      continue;
    }
    ASSIGN_OR_RETURN(const PostgresResult removed,
                     connection.Run(kDeleteOne, PostgresParameters().Add(id)));
    report.num_removed += removed.num_affected();
  }
  return report;
}

absl::Status CountMaps(PostgresConnection& connection, GarbageReport& report) {
  ASSIGN_OR_RETURN(const PostgresResult row, connection.Run(kCount));
  ASSIGN_OR_RETURN(const std::int64_t maps, row.Integer(0, 0));
  ASSIGN_OR_RETURN(const std::int64_t versions, row.Integer(0, 1));
  report.num_maps = static_cast<std::uint64_t>(maps);
  report.num_versions = static_cast<std::uint64_t>(versions);
  return absl::OkStatus();
}

absl::Status FetchMap(PostgresConnection& connection,
                      const PostgresEntry& entry,
                      const std::filesystem::path& file) {
  // One snapshot: a delete in between does not cut the content short.
  return connection.Transaction(
      "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY", [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const bool exists, MapExists(connection, entry.id));
        if (!exists) return NoSuchMap(entry.map.name, entry.map.version);
        return FetchContent(
            connection, entry.id, entry.map.info.file_bytes, file);
      });
}

absl::StatusOr<std::int64_t> CurrentTransaction(
    PostgresConnection& connection) {
  ASSIGN_OR_RETURN(const PostgresResult row, connection.Run(kTransaction));
  return row.Integer(0, 0);
}

absl::StatusOr<bool> WasCommitted(PostgresConnection& connection,
                                  std::int64_t transaction) {
  for (;;) {
    ASSIGN_OR_RETURN(
        const PostgresResult row,
        connection.Run(kOutcome, PostgresParameters().Add(transaction)));
    const std::string_view outcome = row.Text(0, 0);
    if (outcome == "committed") return true;
    if (outcome == "aborted") return false;
    if (outcome != "in progress") {
      return absl::UnknownError("PostgreSQL does not know the transaction");
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

}  // namespace groundlock::storage::internal
