// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/catalogue.h"

#include <sqlite3.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

// "GLMS" in the file's header tells our catalogues from other SQLite files.
constexpr std::int64_t kApplicationId = 0x474C4D53;
constexpr std::int64_t kSchemaVersion = 1;
constexpr int kBusyTimeout_ms = 30'000;

constexpr const char* kSchema = R"sql(
CREATE TABLE names (
  name TEXT PRIMARY KEY,
  last_version INTEGER NOT NULL  -- also of deleted maps
) WITHOUT ROWID;
CREATE TABLE maps (
  name TEXT NOT NULL,
  version INTEGER NOT NULL,
  file TEXT NOT NULL UNIQUE,
  created_ns INTEGER NOT NULL,  -- since 1970, UTC
  content_hash TEXT NOT NULL,
  source_format TEXT NOT NULL,
  metric INTEGER NOT NULL,
  num_cameras INTEGER NOT NULL,
  num_views INTEGER NOT NULL,
  num_landmarks INTEGER NOT NULL,
  num_observations INTEGER NOT NULL,
  has_descriptors INTEGER NOT NULL,
  file_bytes INTEGER NOT NULL,
  mean_reprojection_error_px REAL NOT NULL,
  scale REAL NOT NULL,  -- world_from_source
  qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
  tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
  ground_nx REAL NOT NULL, ground_ny REAL NOT NULL, ground_nz REAL NOT NULL,
  ground_d REAL NOT NULL,
  PRIMARY KEY (name, version)
) WITHOUT ROWID;
)sql";

constexpr const char* kColumns =
    "name, version, file, created_ns, content_hash, source_format, metric, "
    "num_cameras, num_views, num_landmarks, num_observations, has_descriptors, "
    "file_bytes, mean_reprojection_error_px, scale, qx, qy, qz, qw, tx, ty, "
    "tz, ground_nx, ground_ny, ground_nz, ground_d";
constexpr int kNumColumns = 26;

absl::Status SqliteStatus(sqlite3* database, int code) {
  const std::string message = absl::StrCat(
      "catalogue: ",
      database != nullptr ? sqlite3_errmsg(database) : sqlite3_errstr(code));
  switch (code & 0xFF) {
    case SQLITE_NOTADB:
    case SQLITE_CORRUPT:
      return absl::DataLossError(message);
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return absl::UnavailableError(message);
    case SQLITE_FULL:
    case SQLITE_NOMEM:
      return absl::ResourceExhaustedError(message);
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_CANTOPEN:
      return absl::PermissionDeniedError(message);
    default:
      return absl::InternalError(message);
  }
}

// A prepared statement; values are bound and read in order of the columns.
class Statement {
 public:
  static absl::StatusOr<Statement> Prepare(sqlite3* database,
                                           const std::string& sql) {
    sqlite3_stmt* statement = nullptr;
    const int code = sqlite3_prepare_v2(database,
                                        sql.data(),
                                        static_cast<int>(sql.size()),
                                        &statement,
                                        nullptr);
    if (code != SQLITE_OK) return SqliteStatus(database, code);
    return Statement(database, statement);
  }
  Statement(Statement&& other) noexcept
      : database_(other.database_),
        statement_(std::exchange(other.statement_, nullptr)) {}
  Statement& operator=(Statement&& other) = delete;
  ~Statement() { sqlite3_finalize(statement_); }

  void Bind(std::string_view text) {
    sqlite3_bind_text(statement_,
                      ++bound_,
                      text.data(),
                      static_cast<int>(text.size()),
                      SQLITE_TRANSIENT);
  }
  void Bind(std::int64_t value) {
    sqlite3_bind_int64(statement_, ++bound_, value);
  }
  void Bind(std::uint64_t value) { Bind(static_cast<std::int64_t>(value)); }
  void Bind(double value) { sqlite3_bind_double(statement_, ++bound_, value); }

  // True if there is a row.
  absl::StatusOr<bool> Step() {
    read_ = 0;
    const int code = sqlite3_step(statement_);
    if (code == SQLITE_ROW) return true;
    if (code == SQLITE_DONE) return false;
    return SqliteStatus(database_, code);
  }

  std::string Text() {
    const int column = read_++;
    const auto* text = sqlite3_column_text(statement_, column);
    const int bytes = sqlite3_column_bytes(statement_, column);
    if (text == nullptr) return {};
    return {reinterpret_cast<const char*>(text),
            static_cast<std::size_t>(bytes)};
  }
  std::int64_t Integer() { return sqlite3_column_int64(statement_, read_++); }
  std::uint64_t Unsigned() { return static_cast<std::uint64_t>(Integer()); }
  double Real() { return sqlite3_column_double(statement_, read_++); }

 private:
  Statement(sqlite3* database, sqlite3_stmt* statement)
      : database_(database), statement_(statement) {}

  sqlite3* database_;
  sqlite3_stmt* statement_;
  int bound_ = 0;
  int read_ = 0;
};

void BindEntry(const CatalogueEntry& entry, Statement& row) {
  const map::MapInfo& info = entry.map.info;
  row.Bind(entry.map.name);
  row.Bind(entry.map.version);
  row.Bind(entry.file);
  row.Bind(std::int64_t{std::chrono::duration_cast<std::chrono::nanoseconds>(
                            entry.map.created.time_since_epoch())
                            .count()});
  row.Bind(info.content_hash);
  row.Bind(info.source_format);
  row.Bind(std::int64_t{info.metric ? 1 : 0});
  row.Bind(info.num_cameras);
  row.Bind(info.num_views);
  row.Bind(info.num_landmarks);
  row.Bind(info.num_observations);
  row.Bind(std::int64_t{info.has_descriptors ? 1 : 0});
  row.Bind(info.file_bytes);
  row.Bind(info.mean_reprojection_error_px);
  row.Bind(info.world_from_source.scale);
  for (const double v : info.world_from_source.rotation.coeffs()) row.Bind(v);
  for (const double v : info.world_from_source.translation) row.Bind(v);
  for (const double v : info.ground_world.normal) row.Bind(v);
  row.Bind(info.ground_world.d);
}

CatalogueEntry ReadEntry(Statement& row) {
  CatalogueEntry entry;
  map::MapInfo& info = entry.map.info;
  entry.map.name = row.Text();
  entry.map.version = row.Unsigned();
  entry.file = row.Text();
  entry.map.created = std::chrono::system_clock::time_point(
      std::chrono::duration_cast<std::chrono::system_clock::duration>(
          std::chrono::nanoseconds(row.Integer())));
  info.content_hash = row.Text();
  info.source_format = row.Text();
  info.metric = row.Integer() != 0;
  info.num_cameras = row.Unsigned();
  info.num_views = row.Unsigned();
  info.num_landmarks = row.Unsigned();
  info.num_observations = row.Unsigned();
  info.has_descriptors = row.Integer() != 0;
  info.file_bytes = row.Unsigned();
  info.mean_reprojection_error_px = row.Real();
  info.world_from_source.scale = row.Real();
  for (double& v : info.world_from_source.rotation.coeffs()) v = row.Real();
  for (double& v : info.world_from_source.translation) v = row.Real();
  for (double& v : info.ground_world.normal) v = row.Real();
  info.ground_world.d = row.Real();
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
  RETURN_IF_ERROR(Execute("PRAGMA synchronous = EXTRA"));
  return Transaction([this]() -> absl::Status {
    ASSIGN_OR_RETURN(const std::int64_t id, Integer("PRAGMA application_id"));
    ASSIGN_OR_RETURN(const std::int64_t tables,
                     Integer("SELECT count(*) FROM sqlite_schema"));
    ASSIGN_OR_RETURN(const std::int64_t version,
                     Integer("PRAGMA user_version"));
    if (id == 0 && tables == 0 && version == 0) {
      RETURN_IF_ERROR(Execute(kSchema));
      RETURN_IF_ERROR(Execute(
          absl::StrCat("PRAGMA application_id = ", kApplicationId).c_str()));
      return Execute(
          absl::StrCat("PRAGMA user_version = ", kSchemaVersion).c_str());
    }
    if (id != kApplicationId) {
      return absl::FailedPreconditionError(
          "catalogue: an SQLite file of another program");
    }
    if (version != kSchemaVersion) {
      return absl::UnimplementedError(
          absl::StrCat("catalogue: schema version ",
                       version,
                       ", this program knows version ",
                       kSchemaVersion));
    }
    return absl::OkStatus();
  });
}

absl::Status Catalogue::Execute(const char* sql) {
  const int code = sqlite3_exec(database_, sql, nullptr, nullptr, nullptr);
  return code == SQLITE_OK ? absl::OkStatus() : SqliteStatus(database_, code);
}

absl::StatusOr<std::int64_t> Catalogue::Integer(const char* sql) {
  ASSIGN_OR_RETURN(Statement statement, Statement::Prepare(database_, sql));
  ASSIGN_OR_RETURN(const bool found, statement.Step());
  return found ? statement.Integer() : 0;
}

absl::Status Catalogue::Transaction(const std::function<absl::Status()>& body) {
  RETURN_IF_ERROR(Execute("BEGIN IMMEDIATE"));
  absl::Status status = body();
  if (status.ok()) status = Execute("COMMIT");
  // SQLite has rolled back by itself after some errors; then this one fails.
  if (!status.ok()) Execute("ROLLBACK").IgnoreError();
  return status;
}

absl::StatusOr<std::uint64_t> Catalogue::TakeNextVersion(
    std::string_view name) {
  ASSIGN_OR_RETURN(
      Statement statement,
      Statement::Prepare(database_,
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
  std::string marks = "?";
  for (int i = 1; i < kNumColumns; ++i) marks += ", ?";
  ASSIGN_OR_RETURN(
      Statement statement,
      Statement::Prepare(
          database_,
          absl::StrCat(
              "INSERT INTO maps (", kColumns, ") VALUES (", marks, ")")));
  BindEntry(entry, statement);
  return statement.Step().status();
}

absl::Status Catalogue::Remove(std::string_view name) {
  ASSIGN_OR_RETURN(
      Statement statement,
      Statement::Prepare(database_, "DELETE FROM maps WHERE name = ?"));
  statement.Bind(name);
  return statement.Step().status();
}

absl::StatusOr<std::vector<CatalogueEntry>> Catalogue::Select(
    const std::string& sql, std::string_view name) {
  ASSIGN_OR_RETURN(Statement statement, Statement::Prepare(database_, sql));
  if (!name.empty()) statement.Bind(name);
  std::vector<CatalogueEntry> entries;
  for (;;) {
    ASSIGN_OR_RETURN(const bool found, statement.Step());
    if (!found) return entries;
    entries.push_back(ReadEntry(statement));
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
  ASSIGN_OR_RETURN(Statement statement,
                   Statement::Prepare(database_, "SELECT file FROM maps"));
  std::vector<std::string> files;
  for (;;) {
    ASSIGN_OR_RETURN(const bool found, statement.Step());
    if (!found) return files;
    files.push_back(statement.Text());
  }
}

}  // namespace groundlock::storage::internal
