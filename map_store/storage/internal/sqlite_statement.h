// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_SQLITE_STATEMENT_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_SQLITE_STATEMENT_H_

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

struct sqlite3;
struct sqlite3_stmt;

namespace groundlock::storage::internal {

// What SQLite says of an error; `database` may be null.
absl::Status SqliteStatus(sqlite3* database, int code);

// A prepared statement; values are bound and read in order of the columns.
class SqliteStatement {
 public:
  static absl::StatusOr<SqliteStatement> Prepare(sqlite3* database,
                                                 const std::string& sql);
  SqliteStatement(SqliteStatement&& other) noexcept;
  SqliteStatement& operator=(SqliteStatement&& other) = delete;
  ~SqliteStatement();

  void Bind(std::string_view text);
  void Bind(std::int64_t value);
  void Bind(std::uint64_t value) { Bind(static_cast<std::int64_t>(value)); }

  // True if there is a row.
  absl::StatusOr<bool> Step();

  std::string Text();
  std::int64_t Integer();
  std::uint64_t Unsigned() { return static_cast<std::uint64_t>(Integer()); }
  double Real();

 private:
  SqliteStatement(sqlite3* database, sqlite3_stmt* statement)
      : database_(database), statement_(statement) {}

  sqlite3* database_;
  sqlite3_stmt* statement_;
  int bound_ = 0;
  int read_ = 0;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_SQLITE_STATEMENT_H_
