// SPDX-License-Identifier: Apache-2.0
// The SQLite catalogue of a directory store: which map files there are.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/storage/store.h"

struct sqlite3;

namespace groundlock::storage::internal {

struct CatalogueEntry {
  MapVersion map;
  std::string file;  // name within the folder of maps
};

// Not thread-safe; safe against other processes.
class Catalogue {
 public:
  // Opens the file, or creates it with our schema if it is absent or empty; a
  // catalogue with an older schema is brought to ours.
  // kFailedPrecondition: an SQLite file of something else. kUnimplemented: our
  // catalogue with a newer schema. kDataLoss: no SQLite file.
  static absl::StatusOr<std::unique_ptr<Catalogue>> Open(
      const std::filesystem::path& path);
  ~Catalogue();
  Catalogue(const Catalogue&) = delete;
  Catalogue& operator=(const Catalogue&) = delete;

  // Runs `body` while no other process can write, then commits; rolls back if
  // it returns an error.
  absl::Status Transaction(const std::function<absl::Status()>& body);

  // The version that the next map of this name gets; versions of deleted maps
  // are not used again. Inside a transaction.
  absl::StatusOr<std::uint64_t> TakeNextVersion(std::string_view name);
  absl::Status Insert(const CatalogueEntry& entry);
  // Removes one version.
  absl::Status Remove(std::string_view name, std::uint64_t version);
  absl::Status RemoveAll(std::string_view name);

  // The newest version of each map, by name.
  absl::StatusOr<std::vector<CatalogueEntry>> Newest();
  // All versions of a map, newest first; empty if there is none.
  absl::StatusOr<std::vector<CatalogueEntry>> VersionsOf(std::string_view name);
  absl::StatusOr<std::vector<std::string>> Files();
  // Sets num_maps and num_versions.
  absl::Status Count(GarbageReport& report);

 private:
  explicit Catalogue(sqlite3* database) : database_(database) {}
  absl::Status Prepare();
  absl::StatusOr<std::vector<CatalogueEntry>> Select(const std::string& sql,
                                                     std::string_view name);

  sqlite3* database_;
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_CATALOGUE_H_
