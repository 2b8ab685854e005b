// SPDX-License-Identifier: Apache-2.0
// The store: named maps, each a sequence of immutable versions.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/map.h"
#include "map_store/map/map_data.h"

namespace groundlock::storage {

// 1 to 64 characters of [A-Za-z0-9._-], not starting with a dot or a dash.
absl::Status ValidateMapName(std::string_view name);
// The names that a store takes: such a name, or TENANT@NAME (ValidateTenant of
// base/token_file.h has the same rule), for servers that keep maps of several
// tenants apart.
absl::Status ValidateStoredName(std::string_view name);

struct MapVersion {
  std::string name;
  std::uint64_t version = 0;  // 1, 2, ... within the name
  std::chrono::system_clock::time_point created;
  map::MapInfo info;
};

struct GarbageReport {
  std::uint64_t num_removed = 0;  // versions
  std::uint64_t num_in_use = 0;   // old enough, but somebody has them open
  // What is there afterwards, of all tenants.
  std::uint64_t num_maps = 0;
  std::uint64_t num_versions = 0;
};

// What a store has done since it was opened, and holds now.
struct StoreStats {
  std::uint64_t maps_open = 0;  // now
  // Of stores in a database, whose maps lie in a local cache while they are
  // used; all zero for a directory.
  std::uint64_t cache_hits = 0;
  std::uint64_t cache_misses = 0;    // fetched from the database
  std::uint64_t cache_removals = 0;  // to make room
  std::uint64_t cache_bytes = 0;     // when it was last looked through
  std::uint64_t connections_made = 0;
  std::uint64_t connections_failed = 0;
  std::uint64_t connections_in_use = 0;  // now
  // Attempts that ended because the database was away, or busy.
  std::uint64_t database_away = 0;
};

// Thread-safe, and safe against other processes on the same store.
// kUnavailable: the database does not answer, or stayed busy; whether a Publish
// or Delete took effect is then known to be "no", unless the message says that
// it is not known.
class Store {
 public:
  virtual ~Store() = default;

  // Where the maps are, for people; without passwords.
  virtual std::string Description() const = 0;

  // Writes the map and publishes it as the newest version of `name`. Atomic: on
  // any error, or a crash at any moment, the store is as it was before.
  //   ready  asked when the map is written, which takes its time, and before it
  //          is published: an error of its ends the call, with nothing done
  virtual absl::StatusOr<MapVersion> Publish(
      std::string_view name,
      const map::MapData& data,
      const std::function<absl::Status()>& ready) = 0;
  absl::StatusOr<MapVersion> Publish(std::string_view name,
                                     const map::MapData& data) {
    return Publish(name, data, [] { return absl::OkStatus(); });
  }
  // The newest version of each map, by name.
  virtual absl::StatusOr<std::vector<MapVersion>> List() = 0;
  // All versions of a map, newest first. kNotFound names the map.
  virtual absl::StatusOr<std::vector<MapVersion>> ListVersions(
      std::string_view name) = 0;
  // The newest version, or the given one. kNotFound names the map.
  virtual absl::StatusOr<MapVersion> Get(std::string_view name,
                                         std::uint64_t version = 0) = 0;
  // The map itself; opened once and shared by all that hold it. The file's
  // header is compared with the catalogue's content hash, its content is not
  // read: see Check. kDataLoss: a damaged, exchanged or missing file.
  virtual absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version = 0) = 0;
  // Reads all of a map where it is stored and compares it with its checksums.
  // kDataLoss says what is damaged.
  virtual absl::Status Check(std::string_view name,
                             std::uint64_t version = 0) = 0;
  // Removes all versions of a map. Sessions that hold it keep their mapping.
  virtual absl::Status Delete(std::string_view name) = 0;
  // Removes versions that are older than the newest `keep_newest` of their map
  // and that nobody, in any process, has open; 0 keeps all. Removes what dead
  // processes left.
  virtual absl::StatusOr<GarbageReport> CollectGarbage(
      std::uint64_t keep_newest) = 0;
  // Costs nothing: asks neither disk nor database.
  virtual StoreStats Stats() const { return {}; }
};

// Maps of a database lie in a local folder while they are used.
struct CacheOptions {
  std::filesystem::path directory = "groundlock-cache";
  // The least recently used maps are removed beyond it; maps that are open
  // count, but stay.
  std::uint64_t max_bytes = std::uint64_t{20} << 30;
};

// `location` is
//   a directory (created if absent), with an SQLite catalogue inside; or
//   postgresql://[USER@][HOST][:PORT]/DATABASE[?...], as libpq has it; the
//     tables are made in a schema "groundlock" of that database.
// Left-overs of interrupted imports are removed on opening. kUnimplemented: a
// newer program has written the store. kUnavailable: the database cannot be
// reached.
absl::StatusOr<std::unique_ptr<Store>> OpenStore(
    const std::string& location, const CacheOptions& cache = {});

// A location as it may be shown: without passwords.
std::string WithoutPassword(const std::string& location);

}  // namespace groundlock::storage

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_
