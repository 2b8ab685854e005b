// SPDX-License-Identifier: Apache-2.0
// The catalogue's tables, and how those of older versions become ours.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_SCHEMA_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_SCHEMA_H_

#include "absl/status/status.h"

struct sqlite3;

namespace groundlock::storage::internal {

absl::Status ExecuteSql(sqlite3* database, const char* sql);

// Creates the tables in an empty database, or brings older ones up to date.
// Inside a transaction: all or nothing. Errors as of Catalogue::Open.
absl::Status PrepareSchema(sqlite3* database);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_SCHEMA_H_
