// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/catalogue_schema.h"

#include <sqlite3.h>

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/map/map.h"
#include "map_store/storage/internal/map_info_json.h"
#include "map_store/storage/internal/sqlite_statement.h"

namespace groundlock::storage::internal {
namespace {

// "GLMS" in the file's header tells our catalogues from other SQLite files.
constexpr std::int64_t kApplicationId = 0x474C4D53;
constexpr std::int64_t kSchemaVersion = 2;

constexpr const char* kNames = R"sql(
CREATE TABLE names (
  name TEXT PRIMARY KEY,
  last_version INTEGER NOT NULL  -- also of deleted maps
) WITHOUT ROWID;
)sql";

constexpr const char* kMaps = R"sql(
CREATE TABLE maps (
  name TEXT NOT NULL,
  version INTEGER NOT NULL,
  file TEXT NOT NULL UNIQUE,
  created_ns INTEGER NOT NULL,  -- since 1970, UTC
  info TEXT NOT NULL,  -- JSON
  PRIMARY KEY (name, version)
) WITHOUT ROWID;
)sql";

absl::StatusOr<std::int64_t> Integer(sqlite3* database, const char* sql) {
  ASSIGN_OR_RETURN(SqliteStatement statement,
                   SqliteStatement::Prepare(database, sql));
  ASSIGN_OR_RETURN(const bool found, statement.Step());
  return found ? statement.Integer() : 0;
}

struct Row {
  std::string name;
  std::uint64_t version = 0;
  std::string file;
  std::int64_t created_ns = 0;
  std::string info;
};

// Version 1 had a column for each number of a map's info.
absl::StatusOr<std::vector<Row>> ReadVersion1(sqlite3* database) {
  ASSIGN_OR_RETURN(
      SqliteStatement read,
      SqliteStatement::Prepare(
          database,
          "SELECT name, version, file, created_ns, content_hash, "
          "source_format, metric, num_cameras, num_views, num_landmarks, "
          "num_observations, has_descriptors, file_bytes, "
          "mean_reprojection_error_px, scale, qx, qy, qz, qw, tx, ty, tz, "
          "ground_nx, ground_ny, ground_nz, ground_d FROM maps"));
  std::vector<Row> rows;
  for (;;) {
    ASSIGN_OR_RETURN(const bool found, read.Step());
    if (!found) return rows;
    Row& row = rows.emplace_back();
    row.name = read.Text();
    row.version = read.Unsigned();
    row.file = read.Text();
    row.created_ns = read.Integer();
    map::MapInfo info;
    info.content_hash = read.Text();
    info.source_format = read.Text();
    info.metric = read.Integer() != 0;
    info.num_cameras = read.Unsigned();
    info.num_views = read.Unsigned();
    info.num_landmarks = read.Unsigned();
    info.num_observations = read.Unsigned();
    info.has_descriptors = read.Integer() != 0;
    info.file_bytes = read.Unsigned();
    info.mean_reprojection_error_px = read.Real();
    info.world_from_source.scale = read.Real();
    for (double& v : info.world_from_source.rotation.coeffs()) v = read.Real();
    for (double& v : info.world_from_source.translation) v = read.Real();
    for (double& v : info.ground_world.normal) v = read.Real();
    info.ground_world.d = read.Real();
    row.info = MapInfoToJson(info);
  }
}

absl::Status MigrateFromVersion1(sqlite3* database) {
  ASSIGN_OR_RETURN(const std::vector<Row> rows, ReadVersion1(database));
  RETURN_IF_ERROR(ExecuteSql(database, "DROP TABLE maps"));
  RETURN_IF_ERROR(ExecuteSql(database, kMaps));
  for (const Row& row : rows) {
    ASSIGN_OR_RETURN(SqliteStatement insert,
                     SqliteStatement::Prepare(
                         database, "INSERT INTO maps VALUES (?, ?, ?, ?, ?)"));
    insert.Bind(row.name);
    insert.Bind(row.version);
    insert.Bind(row.file);
    insert.Bind(row.created_ns);
    insert.Bind(row.info);
    RETURN_IF_ERROR(insert.Step().status());
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ExecuteSql(sqlite3* database, const char* sql) {
  const int code = sqlite3_exec(database, sql, nullptr, nullptr, nullptr);
  return code == SQLITE_OK ? absl::OkStatus() : SqliteStatus(database, code);
}

absl::Status PrepareSchema(sqlite3* database) {
  ASSIGN_OR_RETURN(const std::int64_t id,
                   Integer(database, "PRAGMA application_id"));
  ASSIGN_OR_RETURN(const std::int64_t tables,
                   Integer(database, "SELECT count(*) FROM sqlite_schema"));
  ASSIGN_OR_RETURN(const std::int64_t version,
                   Integer(database, "PRAGMA user_version"));
  if (id == 0 && tables == 0 && version == 0) {
    RETURN_IF_ERROR(ExecuteSql(database, kNames));
    RETURN_IF_ERROR(ExecuteSql(database, kMaps));
    RETURN_IF_ERROR(ExecuteSql(
        database,
        absl::StrCat("PRAGMA application_id = ", kApplicationId).c_str()));
  } else if (id != kApplicationId) {
    return absl::FailedPreconditionError(
        "catalogue: an SQLite file of another program");
  } else if (version == kSchemaVersion) {
    return absl::OkStatus();
  } else if (version == 1) {
    RETURN_IF_ERROR(MigrateFromVersion1(database));
  } else {
    return absl::UnimplementedError(
        absl::StrCat("catalogue: schema version ",
                     version,
                     ", this program knows versions up to ",
                     kSchemaVersion,
                     ": use the program that wrote it, or a newer one"));
  }
  return ExecuteSql(
      database, absl::StrCat("PRAGMA user_version = ", kSchemaVersion).c_str());
}

}  // namespace groundlock::storage::internal
