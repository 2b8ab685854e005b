// SPDX-License-Identifier: Apache-2.0
// The few SQLite calls that COLMAP's database needs, with errors as Status.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SQLITE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SQLITE_H_

#include <sqlite3.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::formats::internal {

// One prepared statement; not thread-safe.
class SqlStatement {
 public:
  explicit SqlStatement(sqlite3_stmt* statement) : statement_(statement) {}

  void Bind(int index, std::int64_t value);
  void BindBlob(int index, std::string_view bytes);  // must outlive Step
  void BindText(int index, std::string_view text);   // must outlive Step

  // True if there is a row, false at the end.
  absl::StatusOr<bool> Step();
  // Runs a statement without rows and makes it ready to be bound again.
  absl::Status RunOnce();
  absl::Status Reset();

  std::int64_t Int(int column) const;
  // Valid until the next Step; empty if NULL.
  std::string_view Blob(int column) const;
  std::string_view Text(int column) const;

 private:
  absl::Status Error() const;
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const;
  };
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
};

class SqlDatabase {
 public:
  // An untrusted file, read-only; what asks more of SQLite than the file's size
  // explains is kInvalidArgument. A database in WAL mode opens even where
  // nothing may be written beside it.
  static absl::StatusOr<SqlDatabase> OpenUntrusted(
      const std::filesystem::path& path);
  // A file of our own that is there.
  static absl::StatusOr<SqlDatabase> OpenForWriting(
      const std::filesystem::path& path);
  static absl::StatusOr<SqlDatabase> CreateNew(
      const std::filesystem::path& path);

  absl::Status Execute(const std::string& sql);
  absl::StatusOr<SqlStatement> Prepare(std::string_view sql);
  // Whether `name` is a real table: a view can hide an endless query, and a
  // column that is computed can be gigabytes in each row.
  absl::StatusOr<bool> HasTable(std::string_view name);

 private:
  struct Close {
    void operator()(sqlite3* db) const;
  };
  SqlDatabase(sqlite3* db, std::string name)
      : db_(db), name_(std::move(name)) {}
  static absl::StatusOr<SqlDatabase> Open(const std::string& uri,
                                          int flags,
                                          const std::filesystem::path& path);
  absl::Status Error() const;

  std::unique_ptr<std::int64_t> instructions_left_;  // db_ counts them down
  std::unique_ptr<sqlite3, Close> db_;
  std::string name_;  // the path, for messages
};

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SQLITE_H_
