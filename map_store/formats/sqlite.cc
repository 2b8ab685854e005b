// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/sqlite.h"

#include <algorithm>

#include "map_store/base/status.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

// What reading a database may cost, in instructions of SQLite's machine. To
// walk through a table takes some ten of them a row, and a row some bytes; to
// look a name up, fifty.
constexpr std::int64_t kInstructions = 50'000'000;
constexpr std::int64_t kInstructionsPerByte = 16;
constexpr int kInstructionsAtOnce = 10'000;
constexpr std::uintmax_t kMaxBytes = std::uintmax_t{1} << 40;

// SQLite's URI syntax takes '%', '?' and '#' as its own.
std::string UriFromPath(const fs::path& path) {
  std::string uri = "file:";
  for (const char c : path.string()) {
    switch (c) {
      case '%':
        uri += "%25";
        break;
      case '?':
        uri += "%3f";
        break;
      case '#':
        uri += "%23";
        break;
      default:
        uri += c;
    }
  }
  return uri;
}

absl::Status StatusFromSqlite(int code, const std::string& message) {
  if (code == SQLITE_NOTADB || code == SQLITE_CORRUPT) {
    return absl::InvalidArgumentError(message);
  }
  if (code == SQLITE_INTERRUPT) {
    return absl::InvalidArgumentError(
        absl::StrCat(message, ": takes more work than a database of its size"));
  }
  if (code == SQLITE_TOOBIG || code == SQLITE_NOMEM) {
    return absl::ResourceExhaustedError(message);
  }
  return absl::FailedPreconditionError(message);
}

}  // namespace

void SqlStatement::Finalize::operator()(sqlite3_stmt* statement) const {
  sqlite3_finalize(statement);
}

void SqlDatabase::Close::operator()(sqlite3* db) const { sqlite3_close(db); }

void SqlStatement::Bind(int index, std::int64_t value) {
  sqlite3_bind_int64(statement_.get(), index, value);
}

void SqlStatement::BindBlob(int index, std::string_view bytes) {
  // Ownership stays with the caller; see the header.
  sqlite3_bind_blob64(statement_.get(),
                      index,
                      bytes.empty() ? "" : bytes.data(),
                      bytes.size(),
                      nullptr);
}

void SqlStatement::BindText(int index, std::string_view text) {
  sqlite3_bind_text64(statement_.get(),
                      index,
                      text.empty() ? "" : text.data(),
                      text.size(),
                      nullptr,
                      SQLITE_UTF8);
}

absl::Status SqlStatement::Error() const {
  sqlite3* db = sqlite3_db_handle(statement_.get());
  return StatusFromSqlite(sqlite3_errcode(db), sqlite3_errmsg(db));
}

absl::StatusOr<bool> SqlStatement::Step() {
  const int code = sqlite3_step(statement_.get());
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  return Error();
}

absl::Status SqlStatement::RunOnce() {
  ASSIGN_OR_RETURN(const bool row, Step());
  (void)row;
  return Reset();
}

absl::Status SqlStatement::Reset() {
  if (sqlite3_reset(statement_.get()) != SQLITE_OK) return Error();
  return absl::OkStatus();
}

std::int64_t SqlStatement::Int(int column) const {
  return sqlite3_column_int64(statement_.get(), column);
}

std::string_view SqlStatement::Blob(int column) const {
  const void* data = sqlite3_column_blob(statement_.get(), column);
  const int size = sqlite3_column_bytes(statement_.get(), column);
  if (data == nullptr || size <= 0) return {};
  return {static_cast<const char*>(data), static_cast<std::size_t>(size)};
}

std::string_view SqlStatement::Text(int column) const {
  const unsigned char* data = sqlite3_column_text(statement_.get(), column);
  const int size = sqlite3_column_bytes(statement_.get(), column);
  if (data == nullptr || size <= 0) return {};
  return {reinterpret_cast<const char*>(data), static_cast<std::size_t>(size)};
}

absl::StatusOr<SqlDatabase> SqlDatabase::Open(const std::string& uri,
                                              int flags,
                                              const fs::path& path) {
  sqlite3* raw = nullptr;
  const int code = sqlite3_open_v2(uri.c_str(), &raw, flags, nullptr);
  SqlDatabase db(raw, path.string());  // closes even a failed handle
  if (code != SQLITE_OK) return db.Error();
  return db;
}

absl::StatusOr<SqlDatabase> SqlDatabase::OpenUntrusted(const fs::path& path) {
  // immutable=1 needs no lock and no -shm file, but does not see a write-ahead
  // log; so only where there is none to be seen.
  std::error_code error;
  fs::path wal = path;
  wal += "-wal";
  const bool has_wal = fs::exists(wal, error) && fs::file_size(wal, error) > 0;
  ASSIGN_OR_RETURN(
      SqlDatabase db,
      Open(UriFromPath(path) + (has_wal ? "?mode=ro" : "?mode=ro&immutable=1"),
           SQLITE_OPEN_READONLY | SQLITE_OPEN_URI | SQLITE_OPEN_NOMUTEX,
           path));
  sqlite3* raw = db.db_.get();
  // A tree whose branches have grown together is endless in a file of a few
  // kilobytes. The schema is a table as well, and is read by the first
  // statement.
  const std::uintmax_t bytes = fs::file_size(path, error);
  db.instructions_left_ = std::make_unique<std::int64_t>(
      kInstructions +
      kInstructionsPerByte *
          static_cast<std::int64_t>(error ? 0 : std::min(bytes, kMaxBytes)));
  sqlite3_progress_handler(
      raw,
      kInstructionsAtOnce,
      [](void* left) {
        auto& instructions = *static_cast<std::int64_t*>(left);
        instructions -= kInstructionsAtOnce;
        return instructions < 0 ? 1 : 0;
      },
      db.instructions_left_.get());
  sqlite3_db_config(raw, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(raw, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_limit(raw, SQLITE_LIMIT_LENGTH, 1 << 30);
  RETURN_IF_ERROR(db.Execute("PRAGMA query_only = ON"));
  return db;
}

absl::StatusOr<SqlDatabase> SqlDatabase::OpenForWriting(const fs::path& path) {
  return Open(UriFromPath(path), SQLITE_OPEN_READWRITE | SQLITE_OPEN_URI, path);
}

absl::StatusOr<SqlDatabase> SqlDatabase::CreateNew(const fs::path& path) {
  return Open(UriFromPath(path),
              SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_URI,
              path);
}

absl::Status SqlDatabase::Error() const {
  if (db_ == nullptr) return absl::ResourceExhaustedError(name_);
  return StatusFromSqlite(sqlite3_errcode(db_.get()),
                          absl::StrCat(name_, ": ", sqlite3_errmsg(db_.get())));
}

absl::Status SqlDatabase::Execute(const std::string& sql) {
  const int code =
      sqlite3_exec(db_.get(), sql.c_str(), nullptr, nullptr, nullptr);
  return code == SQLITE_OK ? absl::OkStatus() : Error();
}

absl::StatusOr<SqlStatement> SqlDatabase::Prepare(std::string_view sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(db_.get(),
                         sql.data(),
                         static_cast<int>(sql.size()),
                         &statement,
                         nullptr) != SQLITE_OK) {
    return Error();
  }
  return SqlStatement(statement);
}

absl::StatusOr<bool> SqlDatabase::HasTable(std::string_view name) {
  ASSIGN_OR_RETURN(SqlStatement statement,
                   Prepare("SELECT count(*) FROM sqlite_master WHERE "
                           "type = 'table' AND name = ?1 AND "
                           "sql LIKE 'CREATE TABLE%' AND NOT EXISTS (SELECT 1 "
                           "FROM pragma_table_xinfo(?1) WHERE hidden <> 0)"));
  statement.BindText(1, name);
  ASSIGN_OR_RETURN(const bool row, statement.Step());
  return row && statement.Int(0) == 1;
}

}  // namespace groundlock::formats::internal
