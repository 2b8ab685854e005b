// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_schema.h"

#include <array>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/postgres_pins.h"

namespace groundlock::storage::internal {
namespace {

// Step i brings version i to i + 1. Steps that were released never change.
constexpr std::array kSteps = {
    R"sql(
CREATE SCHEMA IF NOT EXISTS groundlock;
CREATE TABLE groundlock.schema (
  version integer NOT NULL
);
INSERT INTO groundlock.schema VALUES (0);
CREATE TABLE groundlock.names (
  name text COLLATE "C" PRIMARY KEY,
  last_version bigint NOT NULL  -- also of deleted maps
);
CREATE TABLE groundlock.maps (
  id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY,  -- never used again
  name text COLLATE "C" NOT NULL,
  version bigint NOT NULL,
  created_ns bigint NOT NULL,  -- since 1970, UTC
  info json NOT NULL,
  UNIQUE (name, version)
);
-- Chunks come before the version that they belong to is taken: so the check of
-- the key waits for the end of the transaction.
CREATE TABLE groundlock.chunks (
  map_id integer NOT NULL REFERENCES groundlock.maps
    ON DELETE CASCADE DEFERRABLE INITIALLY DEFERRED,
  number integer NOT NULL,  -- 0, 1, ...
  bytes bytea NOT NULL CHECK (octet_length(bytes) <= 1048576),
  PRIMARY KEY (map_id, number)
);
-- Descriptors do not compress.
ALTER TABLE groundlock.chunks ALTER COLUMN bytes SET STORAGE EXTERNAL;
)sql",
};

constexpr PostgresStatement kLockSchema = {
    "lock_schema", "SELECT pg_advisory_xact_lock($1::int, 0)"};
constexpr PostgresStatement kHasSchema = {
    "has_schema", "SELECT to_regclass('groundlock.schema') IS NOT NULL"};
constexpr PostgresStatement kVersion = {
    "schema_version", "SELECT version FROM groundlock.schema"};
constexpr PostgresStatement kSetVersion = {
    "set_schema_version", "UPDATE groundlock.schema SET version = $1::int"};

absl::Status Migrate(PostgresConnection& connection) {
  // Two servers that start at once prepare one after the other.
  RETURN_IF_ERROR(
      connection.Run(kLockSchema, PostgresParameters().Add(kPostgresLockSpace))
          .status());
  std::int64_t version = 0;
  ASSIGN_OR_RETURN(const PostgresResult has, connection.Run(kHasSchema));
  if (has.Boolean(0, 0)) {
    ASSIGN_OR_RETURN(const PostgresResult row, connection.Run(kVersion));
    if (row.num_rows() != 1) {
      return absl::DataLossError("table groundlock.schema: not one row");
    }
    ASSIGN_OR_RETURN(version, row.Integer(0, 0));
  }
  constexpr auto kNewest = static_cast<std::int64_t>(kSteps.size());
  if (version < 0 || version > kNewest) {
    return absl::UnimplementedError(
        absl::StrCat(connection.Description(),
                     ": schema version ",
                     version,
                     ", this program knows versions up to ",
                     kNewest,
                     ": use the program that made it, or a newer one"));
  }
  if (version == kNewest) return absl::OkStatus();
  for (std::int64_t step = version; step < kNewest; ++step) {
    RETURN_IF_ERROR(connection.Execute(kSteps.at(static_cast<size_t>(step))));
  }
  return connection.Run(kSetVersion, PostgresParameters().Add(kNewest))
      .status();
}

}  // namespace

absl::Status PreparePostgresSchema(PostgresConnection& connection) {
  const absl::Status status =
      connection.Transaction("BEGIN", [&] { return Migrate(connection); });
  if (!absl::IsPermissionDenied(status)) return status;
  return absl::PermissionDeniedError(
      absl::StrCat(status.message(),
                   " (the user needs CREATE on the database to make the schema "
                   "'groundlock', "
                   "or must own that schema and its tables)"));
}

}  // namespace groundlock::storage::internal
