// SPDX-License-Identifier: Apache-2.0
// The store: named maps, each a sequence of immutable versions.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
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

struct MapVersion {
  std::string name;
  std::uint64_t version = 0;  // 1, 2, ... within the name
  std::chrono::system_clock::time_point created;
  map::MapInfo info;
};

// Thread-safe, and safe against other processes on the same store.
class Store {
 public:
  virtual ~Store() = default;

  // Writes the map and publishes it as the newest version of `name`. Atomic: on
  // any error, or a crash at any moment, the store is as it was before.
  virtual absl::StatusOr<MapVersion> Publish(std::string_view name,
                                             const map::MapData& data) = 0;
  // The newest version of each map, by name.
  virtual absl::StatusOr<std::vector<MapVersion>> List() = 0;
  // The newest version, or the given one. kNotFound names the map.
  virtual absl::StatusOr<MapVersion> Get(std::string_view name,
                                         std::uint64_t version = 0) = 0;
  // The map itself; opened once and shared by all that hold it.
  virtual absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version = 0) = 0;
  // Removes all versions of a map. Sessions that hold it keep their mapping.
  virtual absl::Status Delete(std::string_view name) = 0;
};

// `location` is a directory (created if absent), with an SQLite catalogue
// inside. Left-overs of interrupted imports are removed on opening.
absl::StatusOr<std::unique_ptr<Store>> OpenStore(const std::string& location);

}  // namespace groundlock::storage

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_STORE_H_
