// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/catalogue.h"

#include <sqlite3.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/catalogue_schema.h"
#include "map_store/storage/internal/map_info_json.h"
#include "map_store/storage/internal/sqlite_statement.h"

namespace groundlock::storage::internal {
namespace {

constexpr int kBusyTimeout_ms = 30'000;

constexpr const char* kColumns = "name, version, file, created_ns, info";

absl::StatusOr<CatalogueEntry> ReadEntry(SqliteStatement& row) {
  CatalogueEntry entry;
  entry.map.name = row.Text();
  entry.map.version = row.Unsigned();
  entry.file = row.Text();
  entry.map.created = std::chrono::system_clock::time_point(
      std::chrono::duration_cast<std::chrono::system_clock::duration>(
          std::chrono::nanoseconds(row.Integer())));
  auto info = MapInfoFromJson(row.Text());
  if (!info.ok()) return base::Annotate(info.status(), entry.file);
  entry.map.info = *std::move(info);
  return entry;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Catalogue>> Catalogue::Open(
    const std::filesystem::path& path) {
  sqlite3* database = nullptr;
  const int code = sqlite3_open_v2(
      path.c_str(),
      &database,
      SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_FULLMUTEX,
      nullptr);
  std::unique_ptr<Catalogue> catalogue(new Catalogue(database));
  absl::Status status;
  if (code != SQLITE_OK) {
    status = SqliteStatus(database, code);
  } else {
    sqlite3_busy_timeout(database, kBusyTimeout_ms);
    status = catalogue->Prepare();
  }
  if (!status.ok()) return base::Annotate(status, path.string());
  return catalogue;
}

Catalogue::~Catalogue() { sqlite3_close_v2(database_); }

// A rollback journal, synced with its directory: imports are rare, and every
// file system that has rename and locks carries it.
absl::Status Catalogue::Prepare() {
  RETURN_IF_ERROR(ExecuteSql(database_, "PRAGMA synchronous = EXTRA"));
  return Transaction([this] { return PrepareSchema(database_); });
}

absl::Status Catalogue::Transaction(const std::function<absl::Status()>& body) {
  RETURN_IF_ERROR(ExecuteSql(database_, "BEGIN IMMEDIATE"));
  absl::Status status = body();
  if (status.ok()) status = ExecuteSql(database_, "COMMIT");
  // SQLite has rolled back by itself after some errors; then this one fails.
  if (!status.ok()) ExecuteSql(database_, "ROLLBACK").IgnoreError();
  return status;
}

absl::StatusOr<std::uint64_t> Catalogue::TakeNextVersion(
    std::string_view name) {
  ASSIGN_OR_RETURN(SqliteStatement statement,
                   SqliteStatement::Prepare(
                       database_,
                       "INSERT INTO names VALUES (?, 1) ON CONFLICT (name) "
                       "DO UPDATE SET last_version = last_version + 1 "
                       "RETURNING last_version"));
  statement.Bind(name);
  ASSIGN_OR_RETURN(const bool found, statement.Step());
  if (!found) return absl::InternalError("catalogue: no version returned");
  const std::uint64_t version = statement.Unsigned();
  RETURN_IF_ERROR(statement.Step().status());
  return version;
}

absl::Status Catalogue::Insert(const CatalogueEntry& entry) {
  ASSIGN_OR_RETURN(
      SqliteStatement statement,
      SqliteStatement::Prepare(
          database_,
          absl::StrCat(
              "INSERT INTO maps (", kColumns, ") VALUES (?, ?, ?, ?, ?)")));
  statement.Bind(entry.map.name);
  statement.Bind(entry.map.version);
  statement.Bind(entry.file);
  statement.Bind(
      std::int64_t{std::chrono::duration_cast<std::chrono::nanoseconds>(
                       entry.map.created.time_since_epoch())
                       .count()});
  statement.Bind(MapInfoToJson(entry.map.info));
  return statement.Step().status();
}

absl::Status Catalogue::Remove(std::string_view name, std::uint64_t version) {
  ASSIGN_OR_RETURN(
      SqliteStatement statement,
      SqliteStatement::Prepare(
          database_, "DELETE FROM maps WHERE name = ? AND version = ?"));
  statement.Bind(name);
  statement.Bind(version);
  return statement.Step().status();
}

absl::Status Catalogue::RemoveAll(std::string_view name) {
  ASSIGN_OR_RETURN(
      SqliteStatement statement,
      SqliteStatement::Prepare(database_, "DELETE FROM maps WHERE name = ?"));
  statement.Bind(name);
  return statement.Step().status();
}

absl::StatusOr<std::vector<CatalogueEntry>> Catalogue::Select(
    const std::string& sql, std::string_view name) {
  ASSIGN_OR_RETURN(SqliteStatement statement,
                   SqliteStatement::Prepare(database_, sql));
  if (!name.empty()) statement.Bind(name);
  std::vector<CatalogueEntry> entries;
  for (;;) {
    ASSIGN_OR_RETURN(const bool found, statement.Step());
    if (!found) return entries;
    ASSIGN_OR_RETURN(CatalogueEntry entry, ReadEntry(statement));
    entries.push_back(std::move(entry));
  }
}

absl::StatusOr<std::vector<CatalogueEntry>> Catalogue::Newest() {
  return Select(absl::StrCat("SELECT ",
                             kColumns,
                             " FROM maps AS m WHERE version = (SELECT "
                             "max(version) FROM maps WHERE name = m.name) "
                             "ORDER BY name"),
                {});
}

absl::StatusOr<std::vector<CatalogueEntry>> Catalogue::VersionsOf(
    std::string_view name) {
  return Select(absl::StrCat("SELECT ",
                             kColumns,
                             " FROM maps WHERE name = ? ORDER BY version DESC"),
                name);
}

absl::StatusOr<std::vector<std::string>> Catalogue::Files() {
  ASSIGN_OR_RETURN(
      SqliteStatement statement,
      SqliteStatement::Prepare(database_, "SELECT file FROM maps"));
  std::vector<std::string> files;
  for (;;) {
    ASSIGN_OR_RETURN(const bool found, statement.Step());
    if (!found) return files;
    files.push_back(statement.Text());
  }
}

absl::Status Catalogue::Count(GarbageReport& report) {
  ASSIGN_OR_RETURN(
      SqliteStatement statement,
      SqliteStatement::Prepare(
          database_, "SELECT count(DISTINCT name), count(*) FROM maps"));
  RETURN_IF_ERROR(statement.Step().status());
  report.num_maps = statement.Unsigned();
  report.num_versions = statement.Unsigned();
  return absl::OkStatus();
}

}  // namespace groundlock::storage::internal
