// SPDX-License-Identifier: Apache-2.0
// The store in a directory:
//   catalogue.sqlite         what there is; a map exists once its row is there
//   lock                     held for moments: making and sweeping imports
//   imports/.tmp-XXXXXX/     an import in progress: its map, and a held lock
//   maps/NAME.VERSION.glmap  the maps; whoever has one open shares a lock on it
// A map file is renamed into maps/ inside the transaction that adds its row,
// and removed after the one that deletes it. So a crash can leave a file
// without a row, never a row without a file; a sweep removes such files inside
// a transaction of its own, which therefore never meets one that is about to
// get its row.
#include <unistd.h>

#include <set>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/backends.h"
#include "map_store/storage/internal/catalogue.h"
#include "map_store/storage/internal/file_lock.h"
#include "map_store/storage/internal/open_maps.h"
#include "map_store/storage/internal/staging.h"

namespace groundlock::storage::internal {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMapSuffix = ".glmap";

// Each holds a file descriptor until it is gone; the rest goes next time.
constexpr std::size_t kMaxRemovedAtOnce = 200;

absl::Status FileError(std::string_view what,
                       const fs::path& path,
                       const std::error_code& error) {
  return absl::ErrnoToStatus(
      error.value(), absl::StrCat(base::Abseil(what), " ", path.string()));
}

class DirectoryStore final : public Store {
 public:
  DirectoryStore(fs::path root, std::unique_ptr<Catalogue> catalogue)
      : root_(std::move(root)),
        staging_(root_ / "imports", root_ / "lock"),
        catalogue_(std::move(catalogue)) {}

  absl::Status Sweep();

  std::string Description() const override {
    return absl::StrCat("directory ", root_.string());
  }
  using Store::Publish;
  absl::StatusOr<MapVersion> Publish(
      std::string_view name,
      const map::MapData& data,
      const std::function<absl::Status()>& ready) override;
  absl::StatusOr<std::vector<MapVersion>> List() override;
  absl::StatusOr<std::vector<MapVersion>> ListVersions(
      std::string_view name) override;
  absl::StatusOr<MapVersion> Get(std::string_view name,
                                 std::uint64_t version) override;
  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version) override;
  absl::Status Check(std::string_view name, std::uint64_t version) override;
  absl::Status Delete(std::string_view name) override;
  absl::StatusOr<GarbageReport> CollectGarbage(
      std::uint64_t keep_newest) override;
  StoreStats Stats() const override {
    StoreStats stats;
    stats.maps_open = open_.size();
    return stats;
  }

 private:
  fs::path Maps() const { return root_ / "maps"; }

  absl::StatusOr<CatalogueEntry> Find(std::string_view name,
                                      std::uint64_t version)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::shared_ptr<const map::Map>> OpenFile(
      const CatalogueEntry& entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status SweepMaps() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const fs::path root_;
  const StagingArea staging_;
  base::Mutex mutex_;
  std::unique_ptr<Catalogue> catalogue_ ABSL_PT_GUARDED_BY(mutex_);
  OpenMaps open_;  // by file name, which no other map ever gets
};

absl::Status DirectoryStore::Sweep() {
  std::error_code error;
  fs::create_directories(Maps(), error);
  if (error) return FileError("cannot create", Maps(), error);
  RETURN_IF_ERROR(staging_.Sweep());
  base::MutexLock lock(&mutex_);
  return catalogue_->Transaction([this] {
    mutex_.AssertHeld();
    return SweepMaps();
  });
}

absl::Status DirectoryStore::SweepMaps() {
  ASSIGN_OR_RETURN(const std::vector<std::string> files, catalogue_->Files());
  const std::set<std::string> known(files.begin(), files.end());
  std::error_code error;
  for (fs::directory_iterator it(Maps(), error), end; !error && it != end;
       it.increment(error)) {
    const std::string file = it->path().filename().string();
    if (!absl::EndsWith(file, kMapSuffix) || known.count(file) > 0) continue;
    std::error_code ignored;
    fs::remove(it->path(), ignored);
  }
  if (error) return FileError("cannot read", Maps(), error);
  return absl::OkStatus();
}

absl::StatusOr<MapVersion> DirectoryStore::Publish(
    std::string_view name,
    const map::MapData& data,
    const std::function<absl::Status()>& ready) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  ASSIGN_OR_RETURN(const Staging import, staging_.Make());
  const fs::path written = import.path() / "map.glmap";
  RETURN_IF_ERROR(map::WriteMapFile(data, written));
  RETURN_IF_ERROR(ready());
  CatalogueEntry entry;
  {
    ASSIGN_OR_RETURN(const auto map, map::Map::Open(written));
    entry.map.info = map->info();
  }
  entry.map.name = name;
  entry.map.created = std::chrono::system_clock::now();

  base::MutexLock lock(&mutex_);
  RETURN_IF_ERROR(catalogue_->Transaction([&]() -> absl::Status {
    mutex_.AssertHeld();
    ASSIGN_OR_RETURN(entry.map.version, catalogue_->TakeNextVersion(name));
    entry.file =
        absl::StrCat(entry.map.name, ".", entry.map.version, kMapSuffix);
    std::error_code error;
    fs::rename(written, Maps() / entry.file, error);
    if (error) return FileError("cannot rename to", Maps() / entry.file, error);
    absl::Status status = base::SyncDirectory(Maps());
    if (status.ok()) status = catalogue_->Insert(entry);
    if (!status.ok()) fs::remove(Maps() / entry.file, error);
    return status;
  }));
  return entry.map;
}

absl::StatusOr<CatalogueEntry> DirectoryStore::Find(std::string_view name,
                                                    std::uint64_t version) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  ASSIGN_OR_RETURN(std::vector<CatalogueEntry> entries,
                   catalogue_->VersionsOf(name));
  for (CatalogueEntry& entry : entries) {
    if (version == 0 || entry.map.version == version) return std::move(entry);
  }
  return NoSuchMap(name, entries.empty() ? 0 : version);
}

std::vector<MapVersion> MapsOf(std::vector<CatalogueEntry> entries) {
  std::vector<MapVersion> maps;
  maps.reserve(entries.size());
  for (CatalogueEntry& entry : entries) maps.push_back(std::move(entry.map));
  return maps;
}

absl::StatusOr<std::vector<MapVersion>> DirectoryStore::List() {
  base::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(std::vector<CatalogueEntry> entries, catalogue_->Newest());
  return MapsOf(std::move(entries));
}

absl::StatusOr<std::vector<MapVersion>> DirectoryStore::ListVersions(
    std::string_view name) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  base::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(std::vector<CatalogueEntry> entries,
                   catalogue_->VersionsOf(name));
  if (entries.empty()) return NoSuchMap(name, 0);
  return MapsOf(std::move(entries));
}

absl::StatusOr<MapVersion> DirectoryStore::Get(std::string_view name,
                                               std::uint64_t version) {
  base::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(CatalogueEntry entry, Find(name, version));
  return std::move(entry.map);
}

// kAborted: removed just now, look again.
absl::StatusOr<std::shared_ptr<const map::Map>> DirectoryStore::OpenFile(
    const CatalogueEntry& entry) {
  if (auto map = open_.Find(entry.file)) return map;
  const fs::path path = Maps() / entry.file;
  ASSIGN_OR_RETURN(std::optional<FileLock> in_use, FileLock::TryShare(path));
  // Only a garbage collection holds it, and only to remove the file.
  if (!in_use.has_value() || in_use->IsRemoved()) {
    return absl::AbortedError(absl::StrCat(path.string(), ": being removed"));
  }
  ASSIGN_OR_RETURN(auto map, map::Map::Open(path));
  RETURN_IF_ERROR(CheckIdentity(*map, entry.map.info, path.string()));
  return open_.Add(entry.file, WithGuard(*std::move(in_use), std::move(map)));
}

absl::StatusOr<std::shared_ptr<const map::Map>> DirectoryStore::Open(
    std::string_view name, std::uint64_t version) {
  base::MutexLock lock(&mutex_);
  for (;;) {
    ASSIGN_OR_RETURN(const CatalogueEntry entry, Find(name, version));
    auto map = OpenFile(entry);
    if (absl::IsAborted(map.status())) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      continue;
    }
    if (absl::IsNotFound(map.status())) {
      // Removed by another process just now, or somebody removed the file.
      if (Find(name, entry.map.version).ok()) {
        return absl::DataLossError(map.status().message());
      }
      continue;
    }
    return map;
  }
}

absl::Status DirectoryStore::Check(std::string_view name,
                                   std::uint64_t version) {
  ASSIGN_OR_RETURN(const auto map, Open(name, version));
  return base::Annotate(map->Verify(),
                        absl::StrCat("map '", base::Abseil(name), "'"));
}

absl::Status DirectoryStore::Delete(std::string_view name) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  base::MutexLock lock(&mutex_);
  std::vector<CatalogueEntry> entries;
  RETURN_IF_ERROR(catalogue_->Transaction([&]() -> absl::Status {
    mutex_.AssertHeld();
    ASSIGN_OR_RETURN(entries, catalogue_->VersionsOf(name));
    if (entries.empty()) return NoSuchMap(name, 0);
    return catalogue_->RemoveAll(name);
  }));
  // The rows are gone; a file that stays behind is swept on the next opening.
  // Whoever has mapped one keeps it: the kernel frees it after the last.
  for (const CatalogueEntry& entry : entries) {
    std::error_code ignored;
    fs::remove(Maps() / entry.file, ignored);
  }
  return absl::OkStatus();
}

absl::StatusOr<GarbageReport> DirectoryStore::CollectGarbage(
    std::uint64_t keep_newest) {
  RETURN_IF_ERROR(staging_.Sweep());
  GarbageReport report;
  // Held until the files are gone: nobody opens one meanwhile.
  std::vector<std::pair<fs::path, std::optional<FileLock>>> doomed;
  base::MutexLock lock(&mutex_);
  const absl::Status status = catalogue_->Transaction([&]() -> absl::Status {
    mutex_.AssertHeld();
    RETURN_IF_ERROR(SweepMaps());
    if (keep_newest == 0) return absl::OkStatus();
    ASSIGN_OR_RETURN(const auto names, catalogue_->Newest());
    for (const CatalogueEntry& newest : names) {
      ASSIGN_OR_RETURN(const auto entries,
                       catalogue_->VersionsOf(newest.map.name));
      for (std::size_t i = keep_newest; i < entries.size(); ++i) {
        if (doomed.size() >= kMaxRemovedAtOnce) return absl::OkStatus();
        const fs::path path = Maps() / entries[i].file;
        auto unused = FileLock::TryAcquireExisting(path);
        if (unused.ok() && !unused->has_value()) {
          ++report.num_in_use;
          continue;
        }
        // A row whose file is lost goes as well.
        if (!unused.ok() && !absl::IsNotFound(unused.status())) {
          return unused.status();
        }
        RETURN_IF_ERROR(
            catalogue_->Remove(entries[i].map.name, entries[i].map.version));
        if (unused.ok()) doomed.emplace_back(path, *std::move(unused));
        ++report.num_removed;
      }
    }
    return absl::OkStatus();
  });
  RETURN_IF_ERROR(status);
  for (const auto& [path, held] : doomed) {
    std::error_code ignored;
    fs::remove(path, ignored);
  }
  RETURN_IF_ERROR(catalogue_->Count(report));
  return report;
}

// Without a catalogue, maps that lie there are not ours to sweep: the folder is
// somebody else's, or its catalogue was lost.
absl::Status RefuseForeignMaps(const fs::path& root) {
  std::error_code error;
  const bool empty =
      !fs::exists(root / "maps", error) || fs::is_empty(root / "maps", error);
  if (empty && !error) return absl::OkStatus();
  // Looked for last: another process may be making a new store just now.
  if (fs::exists(root / "catalogue.sqlite", error)) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(root.string(),
                   ": has a folder 'maps' but no 'catalogue.sqlite': not a "
                   "store, or its catalogue is lost"));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenDirectoryStore(
    const fs::path& root) {
  std::error_code error;
  fs::create_directories(root, error);
  if (error) return FileError("cannot create the store", root, error);
  RETURN_IF_ERROR(RefuseForeignMaps(root));
  ASSIGN_OR_RETURN(std::unique_ptr<Catalogue> catalogue,
                   Catalogue::Open(root / "catalogue.sqlite"));
  auto store = std::make_unique<DirectoryStore>(root, std::move(catalogue));
  RETURN_IF_ERROR(store->Sweep());
  return store;
}

}  // namespace groundlock::storage::internal
