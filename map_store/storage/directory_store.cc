// SPDX-License-Identifier: Apache-2.0
// The store in a directory:
//   catalogue.sqlite       what there is; a map exists once its row is
//   committed lock                   held for moments: making and sweeping
//   import folders imports/import-XXXXXX/ an import in progress: its map and a
//   held lock file maps/NAME.VERSION.glmap
// A map file is renamed into maps/ inside the transaction that adds its row,
// and removed after the one that deletes it. So a crash can leave a file
// without a row, never a row without a file; Sweep removes such files inside a
// transaction of its own, which therefore never meets one that is about to get
// its row.
#include <unistd.h>

#include <set>
#include <system_error>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/catalogue.h"
#include "map_store/storage/internal/file_lock.h"
#include "map_store/storage/store.h"

namespace groundlock::storage {
namespace {

namespace fs = std::filesystem;
using internal::Catalogue;
using internal::CatalogueEntry;
using internal::FileLock;

constexpr const char* kMapSuffix = ".glmap";
constexpr const char* kImportLock = "lock";

absl::Status FileError(std::string_view what,
                       const fs::path& path,
                       const std::error_code& error) {
  return absl::ErrnoToStatus(
      error.value(), absl::StrCat(base::Abseil(what), " ", path.string()));
}

absl::Status NoSuchMap(std::string_view name, std::uint64_t version) {
  return absl::NotFoundError(
      version == 0
          ? absl::StrCat("no map '", base::Abseil(name), "'")
          : absl::StrCat(
                "no version ", version, " of map '", base::Abseil(name), "'"));
}

class DirectoryStore final : public Store {
 public:
  DirectoryStore(fs::path root, std::unique_ptr<Catalogue> catalogue)
      : root_(std::move(root)), catalogue_(std::move(catalogue)) {}

  absl::Status Sweep();

  absl::StatusOr<MapVersion> Publish(std::string_view name,
                                     const map::MapData& data) override;
  absl::StatusOr<std::vector<MapVersion>> List() override;
  absl::StatusOr<MapVersion> Get(std::string_view name,
                                 std::uint64_t version) override;
  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version) override;
  absl::Status Delete(std::string_view name) override;

 private:
  fs::path Maps() const { return root_ / "maps"; }
  fs::path Imports() const { return root_ / "imports"; }

  absl::Status SweepImports();
  absl::Status SweepMaps();
  absl::StatusOr<CatalogueEntry> Find(std::string_view name,
                                      std::uint64_t version)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const fs::path root_;
  absl::Mutex mutex_;
  std::unique_ptr<Catalogue> catalogue_ ABSL_PT_GUARDED_BY(mutex_);
  // By file name, which no other map ever gets.
  std::map<std::string, std::weak_ptr<const map::Map>> open_
      ABSL_GUARDED_BY(mutex_);
};

absl::Status DirectoryStore::Sweep() {
  std::error_code error;
  for (const fs::path& folder : {Maps(), Imports()}) {
    fs::create_directories(folder, error);
    if (error) return FileError("cannot create", folder, error);
  }
  RETURN_IF_ERROR(SweepImports());
  return SweepMaps();
}

absl::Status DirectoryStore::SweepImports() {
  ASSIGN_OR_RETURN(const FileLock lock, FileLock::Acquire(root_ / "lock"));
  std::error_code error;
  for (fs::directory_iterator it(Imports(), error), end; !error && it != end;
       it.increment(error)) {
    // Only what we made ourselves is ours to remove.
    if (!absl::StartsWith(it->path().filename().string(), ".tmp-")) continue;
    if (!fs::is_directory(it->symlink_status())) continue;
    const auto held = FileLock::TryAcquire(it->path() / kImportLock);
    if (!held.ok() || !held->has_value()) continue;  // an import in progress
    std::error_code ignored;  // it will be tried again on the next opening
    fs::remove_all(it->path(), ignored);
  }
  if (error) return FileError("cannot read", Imports(), error);
  return absl::OkStatus();
}

absl::Status DirectoryStore::SweepMaps() {
  absl::MutexLock lock(&mutex_);
  return catalogue_->Transaction([this]() -> absl::Status {
    mutex_.AssertHeld();
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
  });
}

absl::StatusOr<MapVersion> DirectoryStore::Publish(std::string_view name,
                                                   const map::MapData& data) {
  RETURN_IF_ERROR(ValidateMapName(name));
  // The folder and the lock that protects it appear as one to a sweep.
  absl::StatusOr<FileLock> making = FileLock::Acquire(root_ / "lock");
  if (!making.ok()) return making.status();
  ASSIGN_OR_RETURN(const base::TemporaryDirectory import,
                   base::TemporaryDirectory::Create(Imports()));
  ASSIGN_OR_RETURN(const FileLock in_progress,
                   FileLock::Acquire(import.path() / kImportLock));
  { const FileLock made = *std::move(making); }

  const fs::path written = import.path() / "map.glmap";
  RETURN_IF_ERROR(map::WriteMapFile(data, written));
  CatalogueEntry entry;
  {
    ASSIGN_OR_RETURN(const auto map, map::Map::Open(written));
    entry.map.info = map->info();
  }
  entry.map.name = name;
  entry.map.created = std::chrono::system_clock::now();

  absl::MutexLock lock(&mutex_);
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
  RETURN_IF_ERROR(ValidateMapName(name));
  ASSIGN_OR_RETURN(std::vector<CatalogueEntry> entries,
                   catalogue_->VersionsOf(name));
  for (CatalogueEntry& entry : entries) {
    if (version == 0 || entry.map.version == version) return std::move(entry);
  }
  return NoSuchMap(name, entries.empty() ? 0 : version);
}

absl::StatusOr<std::vector<MapVersion>> DirectoryStore::List() {
  absl::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(std::vector<CatalogueEntry> entries, catalogue_->Newest());
  std::vector<MapVersion> maps;
  maps.reserve(entries.size());
  for (CatalogueEntry& entry : entries) maps.push_back(std::move(entry.map));
  return maps;
}

absl::StatusOr<MapVersion> DirectoryStore::Get(std::string_view name,
                                               std::uint64_t version) {
  absl::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(CatalogueEntry entry, Find(name, version));
  return std::move(entry.map);
}

absl::StatusOr<std::shared_ptr<const map::Map>> DirectoryStore::Open(
    std::string_view name, std::uint64_t version) {
  absl::MutexLock lock(&mutex_);
  ASSIGN_OR_RETURN(const CatalogueEntry entry, Find(name, version));
  std::erase_if(open_, [](const auto& item) { return item.second.expired(); });
  if (const auto found = open_.find(entry.file); found != open_.end()) {
    if (auto map = found->second.lock()) return map;
  }
  auto map = map::Map::Open(Maps() / entry.file);
  if (absl::IsNotFound(map.status())) {
    // Deleted by another process just now, or somebody removed the file.
    RETURN_IF_ERROR(Find(name, entry.map.version).status());
    return absl::DataLossError(map.status().message());
  }
  if (!map.ok()) return map.status();
  if ((*map)->info().content_hash != entry.map.info.content_hash) {
    return absl::DataLossError(
        absl::StrCat((Maps() / entry.file).string(),
                     ": not the map that the catalogue knows: content hash ",
                     (*map)->info().content_hash,
                     " instead of ",
                     entry.map.info.content_hash));
  }
  open_[entry.file] = *map;
  return map;
}

absl::Status DirectoryStore::Delete(std::string_view name) {
  RETURN_IF_ERROR(ValidateMapName(name));
  absl::MutexLock lock(&mutex_);
  std::vector<CatalogueEntry> entries;
  RETURN_IF_ERROR(catalogue_->Transaction([&]() -> absl::Status {
    mutex_.AssertHeld();
    ASSIGN_OR_RETURN(entries, catalogue_->VersionsOf(name));
    if (entries.empty()) return NoSuchMap(name, 0);
    return catalogue_->Remove(name);
  }));
  // The rows are gone; a file that stays behind is swept on the next opening.
  // Whoever has mapped one keeps it: the kernel frees it after the last.
  for (const CatalogueEntry& entry : entries) {
    std::error_code ignored;
    fs::remove(Maps() / entry.file, ignored);
  }
  return absl::OkStatus();
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

absl::Status ValidateMapName(std::string_view name) {
  constexpr std::string_view kAllowed =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-";
  if (name.empty() || name.size() > 64 || name.front() == '.' ||
      name.front() == '-' ||
      name.find_first_not_of(kAllowed) != std::string_view::npos) {
    return absl::InvalidArgumentError(
        "map name: must have 1 to 64 characters of A-Z, a-z, 0-9, '.', '_', "
        "'-' and not start with '.' or '-'");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Store>> OpenStore(const std::string& location) {
  if (location.empty()) {
    return absl::InvalidArgumentError("store: no directory given");
  }
  if (absl::StrContains(location, "://")) {
    return absl::UnimplementedError(
        absl::StrCat("store: ",
                     location.substr(0, location.find("://")),
                     " is not supported; give a directory"));
  }
  const fs::path root(location);
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

}  // namespace groundlock::storage
