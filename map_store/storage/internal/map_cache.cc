// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/map_cache.h"

#include <algorithm>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/backends.h"
#include "map_store/storage/internal/file_lock.h"
#include "map_store/storage/internal/open_maps.h"

namespace groundlock::storage::internal {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kSuffix = ".glmap";
constexpr std::size_t kHashDigits = 32;

bool IsContentHash(std::string_view text) {
  return text.size() == kHashDigits &&
         text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

// Only what we made ourselves is ours to remove.
bool IsCachedMap(const fs::path& path) {
  return path.extension().string() == kSuffix &&
         IsContentHash(path.stem().string());
}

absl::Status CacheError(const fs::path& path, const std::error_code& error) {
  return absl::ErrnoToStatus(
      error.value(), absl::StrCat("map cache: cannot use ", path.string()));
}

struct CachedFile {
  fs::path path;
  std::uint64_t bytes = 0;
  fs::file_time_type used;
};

// Least recently used first. Files that vanish meanwhile are left out.
std::vector<CachedFile> ListCached(const fs::path& folder) {
  std::vector<CachedFile> files;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (!IsCachedMap(it->path())) continue;
    std::error_code gone;
    CachedFile file;
    file.path = it->path();
    file.bytes = fs::file_size(file.path, gone);
    if (!gone) file.used = fs::last_write_time(file.path, gone);
    if (!gone) files.push_back(std::move(file));
  }
  std::sort(files.begin(), files.end(), [](const auto& a, const auto& b) {
    return std::tie(a.used, a.path) < std::tie(b.used, b.path);
  });
  return files;
}

// It is used now. The time of access would be kept by the file system, but is
// often switched off.
void Touch(const fs::path& path) {
  std::error_code ignored;
  fs::last_write_time(path, fs::file_time_type::clock::now(), ignored);
}

}  // namespace

MapCache::MapCache(const CacheOptions& options)
    : options_(options),
      staging_(options_.directory / "staging", options_.directory / "lock") {}

absl::StatusOr<std::unique_ptr<MapCache>> MapCache::Open(
    const CacheOptions& options) {
  if (options.directory.empty()) {
    return absl::InvalidArgumentError("map cache: no directory given");
  }
  std::unique_ptr<MapCache> cache(new MapCache(options));
  for (const char* folder : {"maps", "locks"}) {
    std::error_code error;
    fs::create_directories(options.directory / folder, error);
    if (error) return CacheError(options.directory / folder, error);
  }
  RETURN_IF_ERROR(cache->Sweep());
  return cache;
}

fs::path MapCache::PathOf(const map::MapInfo& info) const {
  return options_.directory / "maps" /
         absl::StrCat(info.content_hash, base::Abseil(kSuffix));
}

fs::path MapCache::LockOf(const map::MapInfo& info) const {
  return options_.directory / "locks" / info.content_hash.substr(0, 2);
}

// kNotFound: neither there nor whole.
absl::StatusOr<std::shared_ptr<const map::Map>> MapCache::OpenCached(
    const map::MapInfo& expected) const {
  const fs::path path = PathOf(expected);
  ASSIGN_OR_RETURN(std::optional<FileLock> in_use, FileLock::TryShare(path));
  if (!in_use.has_value() || in_use->IsRemoved()) {
    return absl::NotFoundError("being removed");
  }
  auto map = map::Map::Open(path);
  absl::Status status = map.status();
  if (status.ok()) status = CheckIdentity(**map, expected, path.string());
  if (!status.ok()) {
    std::error_code ignored;
    fs::remove(path, ignored);
    return absl::NotFoundError(status.message());
  }
  Touch(path);
  return WithGuard(*std::move(in_use), *std::move(map));
}

absl::Status MapCache::FetchInto(const fs::path& file,
                                 const map::MapInfo& expected,
                                 const Fetch& fetch) const {
  RETURN_IF_ERROR(fetch(file));
  // What is damaged on the way, or where it came from, is data loss.
  const auto map = map::Map::Open(file);
  absl::Status status = map.status();
  if (status.ok()) status = CheckIdentity(**map, expected, "fetched map");
  if (status.ok()) status = (*map)->Verify();
  return status;
}

absl::StatusOr<std::shared_ptr<const map::Map>> MapCache::Get(
    const map::MapInfo& expected, const Fetch& fetch) {
  if (!IsContentHash(expected.content_hash)) {
    return absl::DataLossError("content hash: not 32 hexadecimal digits");
  }
  ASSIGN_OR_RETURN(const FileLock fetching,
                   FileLock::Acquire(LockOf(expected)));
  auto map = OpenCached(expected);
  if (!absl::IsNotFound(map.status())) {
    ++hits_;
    return map;
  }
  ++misses_;
  ASSIGN_OR_RETURN(const Staging staging, staging_.Make());
  const fs::path file = staging.path() / "map.glmap";
  MakeRoom(expected.file_bytes);
  RETURN_IF_ERROR(FetchInto(file, expected, fetch));
  // Its lock moves with it: nobody removes it as soon as it is there.
  ASSIGN_OR_RETURN(std::optional<FileLock> in_use, FileLock::TryShare(file));
  ASSIGN_OR_RETURN(auto fetched, map::Map::Open(file));
  std::error_code error;
  fs::rename(file, PathOf(expected), error);
  if (error) return CacheError(PathOf(expected), error);
  return WithGuard(std::move(in_use), std::move(fetched));
}

absl::Status MapCache::Check(const map::MapInfo& expected, const Fetch& fetch) {
  if (!IsContentHash(expected.content_hash)) {
    return absl::DataLossError("content hash: not 32 hexadecimal digits");
  }
  {
    ASSIGN_OR_RETURN(const Staging staging, staging_.Make());
    RETURN_IF_ERROR(FetchInto(staging.path() / "map.glmap", expected, fetch));
  }
  const auto cached = OpenCached(expected);
  if (!cached.ok() || (*cached)->Verify().ok()) return absl::OkStatus();
  // Sessions that have it open keep it; the next one fetches it.
  std::error_code ignored;
  fs::remove(PathOf(expected), ignored);
  return absl::OkStatus();
}

void MapCache::Adopt(const fs::path& file, const map::MapInfo& info) {
  MakeRoom(info.file_bytes);
  std::error_code ignored;  // then it is fetched when it is used
  fs::rename(file, PathOf(info), ignored);
}

void MapCache::MakeRoom(std::uint64_t room) const {
  const std::vector<CachedFile> files = ListCached(options_.directory / "maps");
  std::uint64_t bytes = room;
  for (const CachedFile& file : files) bytes += file.bytes;
  for (const CachedFile& file : files) {
    if (bytes <= options_.max_bytes) break;
    const auto unused = FileLock::TryAcquireExisting(file.path);
    if (!unused.ok() || !unused->has_value()) continue;
    std::error_code error;
    fs::remove(file.path, error);
    if (error) continue;
    bytes -= file.bytes;
    ++removals_;
  }
  bytes_ = bytes;
}

void MapCache::FillStats(StoreStats& stats) const {
  stats.cache_hits = hits_;
  stats.cache_misses = misses_;
  stats.cache_removals = removals_;
  stats.cache_bytes = bytes_;
}

absl::Status MapCache::Sweep() const {
  RETURN_IF_ERROR(staging_.Sweep());
  MakeRoom(0);
  return absl::OkStatus();
}

}  // namespace groundlock::storage::internal
