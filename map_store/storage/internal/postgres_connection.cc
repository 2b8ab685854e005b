// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_connection.h"

#include <charconv>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

// One line, without the trailing newline.
std::string OneLine(const char* message) {
  const std::string line = absl::StrReplaceAll(
      absl::StripAsciiWhitespace(message == nullptr ? "" : message),
      {{"\n\t", " "}, {"\n", "; "}});
  return line.empty() ? "no reason given" : line;
}

std::string Or(const char* text, const char* other) {
  return text == nullptr || *text == '\0' ? other : text;
}

struct Meaning {
  const char* sqlstate;  // or its beginning; the first that fits counts
  absl::StatusCode code;
};

// PostgreSQL 15, appendix A.
constexpr Meaning kMeanings[] = {
    {"08", absl::StatusCode::kUnavailable},   // connection exception
    {"57P", absl::StatusCode::kUnavailable},  // shutdown, starting up
    {"57014", absl::StatusCode::kCancelled},
    {"40", absl::StatusCode::kAborted},     // transaction rollback
    {"55P03", absl::StatusCode::kAborted},  // lock not available
    {"53", absl::StatusCode::kResourceExhausted},
    {"54", absl::StatusCode::kResourceExhausted},  // program limit exceeded
    {"28", absl::StatusCode::kUnauthenticated},
    {"42501", absl::StatusCode::kPermissionDenied},
    {"25006", absl::StatusCode::kFailedPrecondition},  // read-only
    {"3D", absl::StatusCode::kFailedPrecondition},     // no such database
    {"XX001", absl::StatusCode::kDataLoss},
    {"XX002", absl::StatusCode::kDataLoss},
};

absl::StatusCode CodeOf(std::string_view sqlstate) {
  for (const Meaning& meaning : kMeanings) {
    if (absl::StartsWith(base::Abseil(sqlstate), meaning.sqlstate)) {
      return meaning.code;
    }
  }
  return absl::StatusCode::kInternal;
}

// libpq gives no SQLSTATE for a connection that fails: its text has to do.
struct ConnectHint {
  const char* text;
  absl::StatusCode code;
  const char* hint;
};
constexpr ConnectHint kConnectHints[] = {
    {"password authentication failed",
     absl::StatusCode::kUnauthenticated,
     "check the user and the password"},
    {"no password supplied",
     absl::StatusCode::kUnauthenticated,
     "give the password in PGPASSWORD or in a file named by PGPASSFILE"},
    {"authentication failed",
     absl::StatusCode::kUnauthenticated,
     "check the user, and pg_hba.conf of the server"},
    {"no pg_hba.conf entry",
     absl::StatusCode::kUnauthenticated,
     "allow this machine and user in pg_hba.conf of the server"},
    {"does not exist",
     absl::StatusCode::kFailedPrecondition,
     "make the database or user (createdb, createuser) first"},
    {"could not translate host name",
     absl::StatusCode::kUnavailable,
     "check the host's name"},
};

}  // namespace

PostgresParameters& PostgresParameters::Add(std::string_view text) {
  values_.push_back({std::string(text), {}, false});
  return *this;
}

PostgresParameters& PostgresParameters::Add(std::int64_t value) {
  return Add(std::to_string(value));
}

PostgresParameters& PostgresParameters::Add(std::uint64_t value) {
  return Add(std::to_string(value));
}

PostgresParameters& PostgresParameters::AddBytes(std::string_view bytes) {
  values_.push_back({{}, bytes, true});
  return *this;
}

std::uint64_t PostgresResult::num_affected() const {
  const std::string_view text = PQcmdTuples(result_.get());
  std::uint64_t count = 0;
  std::from_chars(text.data(), text.data() + text.size(), count);
  return count;
}

std::string_view PostgresResult::Text(int row, int column) const {
  return {PQgetvalue(result_.get(), row, column),
          static_cast<std::size_t>(PQgetlength(result_.get(), row, column))};
}

absl::StatusOr<std::int64_t> PostgresResult::Integer(int row,
                                                     int column) const {
  const std::string_view text = Text(row, column);
  std::int64_t value = 0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    return absl::DataLossError(absl::StrCat("'",
                                            base::Abseil(text),
                                            "' in column ",
                                            PQfname(result_.get(), column),
                                            " is no number"));
  }
  return value;
}

absl::StatusOr<std::unique_ptr<PostgresConnection>> PostgresConnection::Connect(
    const std::string& url) {
  // What stands before dbname is a default that the URL may override. A network
  // that swallows packets is noticed within half a minute.
  const char* const keywords[] = {"connect_timeout",
                                  "keepalives_idle",
                                  "tcp_user_timeout",
                                  "fallback_application_name",
                                  "dbname",
                                  "client_encoding",
                                  nullptr};
  const char* const values[] = {
      "10", "20", "30000", "groundlock", url.c_str(), "UTF8", nullptr};
  std::unique_ptr<PostgresConnection> connection(new PostgresConnection(
      PQconnectdbParams(keywords, values, /*expand_dbname=*/1)));
  PGconn* const raw = connection->connection_;
  if (raw == nullptr) return absl::ResourceExhaustedError("libpq: no memory");
  if (PQstatus(raw) != CONNECTION_OK) {
    const std::string reason = OneLine(PQerrorMessage(raw));
    absl::StatusCode code = absl::StatusCode::kUnavailable;
    std::string hint = "is PostgreSQL running there, and does it listen there?";
    for (const ConnectHint& candidate : kConnectHints) {
      if (!absl::StrContains(reason, candidate.text)) continue;
      code = candidate.code;
      hint = candidate.hint;
      break;
    }
    return absl::Status(code,
                        absl::StrCat("cannot connect to ",
                                     connection->Description(),
                                     ": ",
                                     reason,
                                     " (",
                                     hint,
                                     ")"));
  }
  // Notices are for people at a terminal.
  PQsetNoticeProcessor(
      raw, [](void* /*arg*/, const char* /*message*/) {}, nullptr);
  // The database, too, shall notice soon that this machine is gone: what it
  // had open counts as in use until then. A pooler may refuse, without harm.
  connection
      ->Execute(
          "SET tcp_keepalives_idle = 20; SET tcp_keepalives_interval = 10; "
          "SET tcp_keepalives_count = 3")
      .IgnoreError();
  return connection;
}

std::string PostgresConnection::Description() const {
  return absl::StrCat("PostgreSQL database '",
                      Or(PQdb(connection_), "?"),
                      "' on ",
                      Or(PQhost(connection_), "localhost"),
                      ":",
                      Or(PQport(connection_), "5432"),
                      " as '",
                      Or(PQuser(connection_), "?"),
                      "'");
}

absl::Status PostgresConnection::Error(const PGresult* result) const {
  const char* sqlstate = PQresultErrorField(result, PG_DIAG_SQLSTATE);
  absl::StatusCode code = CodeOf(Or(sqlstate, ""));
  if (!IsAlive()) code = absl::StatusCode::kUnavailable;
  return absl::Status(
      code,
      absl::StrCat(Description(), ": ", OneLine(PQerrorMessage(connection_))));
}

absl::Status PostgresConnection::Execute(const char* sql) {
  const PostgresResult result(PQexec(connection_, sql));
  PGresult* const raw = result.get();
  const ExecStatusType status = PQresultStatus(raw);
  if (status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK) {
    return absl::OkStatus();
  }
  return Error(raw);
}

absl::StatusOr<PostgresResult> PostgresConnection::Run(
    const PostgresStatement& statement, const PostgresParameters& parameters) {
  if (prepared_.count(statement.name) == 0) {
    const PostgresResult result(
        PQprepare(connection_, statement.name, statement.sql, 0, nullptr));
    if (PQresultStatus(result.get()) != PGRES_COMMAND_OK) {
      return Error(result.get());
    }
    prepared_.insert(statement.name);
  }
  std::vector<const char*> values;
  std::vector<int> lengths;
  std::vector<int> formats;
  for (const PostgresParameters::Value& value : parameters.values_) {
    values.push_back(value.binary ? value.bytes.data() : value.text.c_str());
    lengths.push_back(static_cast<int>(value.bytes.size()));
    formats.push_back(value.binary ? 1 : 0);
  }
  PostgresResult result(PQexecPrepared(connection_,
                                       statement.name,
                                       static_cast<int>(values.size()),
                                       values.data(),
                                       lengths.data(),
                                       formats.data(),
                                       statement.binary_result ? 1 : 0));
  const ExecStatusType status = PQresultStatus(result.get());
  if (status != PGRES_COMMAND_OK && status != PGRES_TUPLES_OK) {
    return Error(result.get());
  }
  return result;
}

absl::Status PostgresConnection::Transaction(
    const char* begin,
    const std::function<absl::Status()>& body,
    bool* outcome_unknown) {
  RETURN_IF_ERROR(Execute(begin));
  absl::Status status = body();
  if (status.ok()) {
    status = Execute("COMMIT");
    if (outcome_unknown != nullptr) {
      *outcome_unknown = !status.ok() && !IsAlive();
    }
  }
  if (!status.ok() && IsAlive()) Execute("ROLLBACK").IgnoreError();
  return status;
}

}  // namespace groundlock::storage::internal
