// SPDX-License-Identifier: Apache-2.0
// One connection to PostgreSQL: libpq with owners and absl::Status.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONNECTION_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONNECTION_H_

#include <libpq-fe.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_set>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::storage::internal {

// A statement that a connection prepares when it first runs it. The name, which
// is unique, stands for the text.
struct PostgresStatement {
  const char* name;
  const char* sql;
  bool binary_result = false;
};

class PostgresParameters {
 public:
  PostgresParameters& Add(std::string_view text);
  PostgresParameters& Add(std::int64_t value);
  PostgresParameters& Add(std::uint64_t value);
  // A bytea; not copied.
  PostgresParameters& AddBytes(std::string_view bytes);

 private:
  friend class PostgresConnection;
  struct Value {
    std::string text;
    std::string_view bytes;
    bool binary = false;
  };
  std::vector<Value> values_;
};

class PostgresResult {
 public:
  explicit PostgresResult(PGresult* result) : result_(result, &PQclear) {}

  PGresult* get() const { return result_.get(); }
  int num_rows() const { return PQntuples(result_.get()); }
  // Of INSERT, UPDATE and DELETE.
  std::uint64_t num_affected() const;
  // Valid while the result lives.
  std::string_view Text(int row, int column) const;
  // kDataLoss if it is no number.
  absl::StatusOr<std::int64_t> Integer(int row, int column) const;
  bool Boolean(int row, int column) const { return Text(row, column) == "t"; }

 private:
  std::unique_ptr<PGresult, decltype(&PQclear)> result_;
};

// Not thread-safe. Errors: kUnavailable, the connection is lost or cannot be
// made; kAborted, a conflict with another transaction; else by their meaning.
class PostgresConnection {
 public:
  // Messages give host, port, database and user, and a hint.
  static absl::StatusOr<std::unique_ptr<PostgresConnection>> Connect(
      const std::string& url);
  ~PostgresConnection() { PQfinish(connection_); }
  PostgresConnection(const PostgresConnection&) = delete;
  PostgresConnection& operator=(const PostgresConnection&) = delete;

  // "PostgreSQL database 'd' on host:port as 'user'".
  std::string Description() const;
  bool IsAlive() const { return PQstatus(connection_) == CONNECTION_OK; }

  // Fixed text, any number of commands.
  absl::Status Execute(const char* sql);
  absl::StatusOr<PostgresResult> Run(const PostgresStatement& statement,
                                     const PostgresParameters& parameters = {});

  // BEGIN, what `body` does, COMMIT; ROLLBACK if it returns an error.
  //   begin  "BEGIN", perhaps with a mode.
  //   outcome_unknown  set if the connection broke after COMMIT was sent.
  absl::Status Transaction(const char* begin,
                           const std::function<absl::Status()>& body,
                           bool* outcome_unknown = nullptr);

 private:
  explicit PostgresConnection(PGconn* connection) : connection_(connection) {}
  absl::Status Error(const PGresult* result) const;

  PGconn* connection_;
  std::unordered_set<std::string_view> prepared_;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_CONNECTION_H_
