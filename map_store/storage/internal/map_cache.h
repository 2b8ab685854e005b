// SPDX-License-Identifier: Apache-2.0
// A local folder of maps that are stored elsewhere, by content hash:
//   lock                 held for moments: making and sweeping staging folders
//   locks/XX             held while maps whose hash begins with XX are fetched
//   staging/.tmp-XXXXXX/ maps on their way in or out
//   maps/HASH.glmap      whoever has one open shares a lock on it
// Everything in it can be fetched again.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_CACHE_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_CACHE_H_

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/map.h"
#include "map_store/storage/internal/staging.h"
#include "map_store/storage/store.h"

namespace groundlock::storage::internal {

// Thread-safe, and safe against other processes on the same folder.
class MapCache {
 public:
  // Creates the folder if it is absent, and sweeps it.
  static absl::StatusOr<std::unique_ptr<MapCache>> Open(
      const CacheOptions& options);

  // Writes the map's file to the path that it is given.
  using Fetch = std::function<absl::Status(const std::filesystem::path&)>;
  // The map with this content. If it is not in the folder, or damaged there, it
  // is fetched, read whole and compared with its checksums first; whoever wants
  // the same map meanwhile, in any process, waits for that. kDataLoss: what was
  // fetched is not `expected`.
  absl::StatusOr<std::shared_ptr<const map::Map>> Get(
      const map::MapInfo& expected, const Fetch& fetch);
  // Fetches the map, whether or not it is there, and reads it whole; removes a
  // damaged copy from the folder.
  absl::Status Check(const map::MapInfo& expected, const Fetch& fetch);

  absl::StatusOr<Staging> Stage() const { return staging_.Make(); }
  // Moves a file, whole and verified, from a staging folder into the cache.
  void Adopt(const std::filesystem::path& file, const map::MapInfo& info);
  // Removes what dead processes left, and what exceeds the size.
  absl::Status Sweep() const;
  // Sets the fields of `stats` that are the cache's.
  void FillStats(StoreStats& stats) const;

 private:
  explicit MapCache(const CacheOptions& options);

  std::filesystem::path PathOf(const map::MapInfo& info) const;
  std::filesystem::path LockOf(const map::MapInfo& info) const;
  absl::StatusOr<std::shared_ptr<const map::Map>> OpenCached(
      const map::MapInfo& expected) const;
  absl::Status FetchInto(const std::filesystem::path& file,
                         const map::MapInfo& expected,
                         const Fetch& fetch) const;
  // Removes the least recently used maps until `room` bytes are left.
  void MakeRoom(std::uint64_t room) const;

  const CacheOptions options_;
  const StagingArea staging_;
  std::atomic<std::uint64_t> hits_{0};
  std::atomic<std::uint64_t> misses_{0};
  mutable std::atomic<std::uint64_t> removals_{0};
  mutable std::atomic<std::uint64_t> bytes_{0};
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_CACHE_H_
