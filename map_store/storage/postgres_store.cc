// SPDX-License-Identifier: Apache-2.0
// The store in a PostgreSQL database. A map is published, and deleted, by one
// transaction; its file lies in the database, and in a local cache while it is
// used. What is left of an import that dies is only local.
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/backends.h"
#include "map_store/storage/internal/map_cache.h"
#include "map_store/storage/internal/open_maps.h"
#include "map_store/storage/internal/postgres_address.h"
#include "map_store/storage/internal/postgres_catalogue.h"
#include "map_store/storage/internal/postgres_pins.h"
#include "map_store/storage/internal/postgres_pool.h"
#include "map_store/storage/internal/postgres_schema.h"

namespace groundlock::storage::internal {
namespace {

namespace fs = std::filesystem;

class PostgresStore final : public Store {
 public:
  PostgresStore(std::string url, std::unique_ptr<MapCache> cache)
      : pool_(url), pins_(url), cache_(std::move(cache)) {}

  absl::Status Prepare();

  std::string Description() const override { return description_; }
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
    cache_->FillStats(stats);
    pool_.FillStats(stats);
    return stats;
  }

 private:
  absl::StatusOr<PostgresEntry> Find(std::string_view name,
                                     std::uint64_t version);
  absl::Status Insert(const fs::path& file, MapVersion& map);
  MapCache::Fetch FetchFor(const PostgresEntry& entry);

  std::string description_;
  PostgresPool pool_;
  PostgresPins pins_;
  OpenMaps open_;  // by id
  const std::unique_ptr<MapCache> cache_;
};

// Once: a program that starts is told at once that the database is not there.
absl::Status PostgresStore::Prepare() {
  return pool_.RunOnce([this](PostgresConnection& connection) {
    description_ = connection.Description();
    return PreparePostgresSchema(connection);
  });
}

absl::Status PostgresStore::Insert(const fs::path& file, MapVersion& map) {
  // Of a COMMIT that was not answered.
  std::optional<std::int64_t> unknown;
  return pool_.Run([&](PostgresConnection& connection) -> absl::Status {
    if (unknown.has_value()) {
      ASSIGN_OR_RETURN(const bool committed,
                       WasCommitted(connection, *unknown));
      unknown.reset();
      if (committed) return absl::OkStatus();
    }
    std::int64_t transaction = 0;
    bool outcome_unknown = false;
    const absl::Status status = connection.Transaction(
        "BEGIN",
        [&]() -> absl::Status {
          RETURN_IF_ERROR(InsertMap(connection, file, map).status());
          ASSIGN_OR_RETURN(transaction, CurrentTransaction(connection));
          return absl::OkStatus();
        },
        &outcome_unknown);
    if (outcome_unknown) unknown = transaction;
    return status;
  });
}

absl::StatusOr<MapVersion> PostgresStore::Publish(
    std::string_view name,
    const map::MapData& data,
    const std::function<absl::Status()>& ready) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  ASSIGN_OR_RETURN(const Staging staging, cache_->Stage());
  const fs::path written = staging.path() / "map.glmap";
  RETURN_IF_ERROR(map::WriteMapFile(data, written));
  RETURN_IF_ERROR(ready());
  MapVersion published;
  {
    ASSIGN_OR_RETURN(const auto map, map::Map::Open(written));
    published.info = map->info();
  }
  published.name = name;
  published.created = std::chrono::system_clock::now();
  RETURN_IF_ERROR(Insert(written, published));
  cache_->Adopt(written, published.info);
  return published;
}

std::vector<MapVersion> MapsOf(std::vector<PostgresEntry> entries) {
  std::vector<MapVersion> maps;
  maps.reserve(entries.size());
  for (PostgresEntry& entry : entries) maps.push_back(std::move(entry.map));
  return maps;
}

absl::StatusOr<std::vector<MapVersion>> PostgresStore::List() {
  std::vector<PostgresEntry> entries;
  RETURN_IF_ERROR(
      pool_.Run([&](PostgresConnection& connection) -> absl::Status {
        ASSIGN_OR_RETURN(entries, SelectNewest(connection));
        return absl::OkStatus();
      }));
  return MapsOf(std::move(entries));
}

absl::StatusOr<std::vector<MapVersion>> PostgresStore::ListVersions(
    std::string_view name) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  std::vector<PostgresEntry> entries;
  RETURN_IF_ERROR(
      pool_.Run([&](PostgresConnection& connection) -> absl::Status {
        ASSIGN_OR_RETURN(entries, SelectVersions(connection, name));
        return absl::OkStatus();
      }));
  if (entries.empty()) return NoSuchMap(name, 0);
  return MapsOf(std::move(entries));
}

absl::StatusOr<PostgresEntry> PostgresStore::Find(std::string_view name,
                                                  std::uint64_t version) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  std::vector<PostgresEntry> entries;
  RETURN_IF_ERROR(
      pool_.Run([&](PostgresConnection& connection) -> absl::Status {
        ASSIGN_OR_RETURN(entries, SelectVersions(connection, name));
        return absl::OkStatus();
      }));
  for (PostgresEntry& entry : entries) {
    if (version == 0 || entry.map.version == version) return std::move(entry);
  }
  return NoSuchMap(name, entries.empty() ? 0 : version);
}

absl::StatusOr<MapVersion> PostgresStore::Get(std::string_view name,
                                              std::uint64_t version) {
  ASSIGN_OR_RETURN(PostgresEntry entry, Find(name, version));
  return std::move(entry.map);
}

MapCache::Fetch PostgresStore::FetchFor(const PostgresEntry& entry) {
  return [this, &entry](const fs::path& file) {
    return pool_.Run([&](PostgresConnection& connection) {
      return FetchMap(connection, entry, file);
    });
  };
}

absl::StatusOr<std::shared_ptr<const map::Map>> PostgresStore::Open(
    std::string_view name, std::uint64_t version) {
  for (;;) {
    ASSIGN_OR_RETURN(const PostgresEntry entry, Find(name, version));
    const std::string key = std::to_string(entry.id);
    if (auto map = open_.Find(key)) return map;
    ASSIGN_OR_RETURN(auto pin, pins_.Take(entry.id));
    // Pinned now, but it may have gone before: then look again.
    bool exists = false;
    RETURN_IF_ERROR(
        pool_.Run([&](PostgresConnection& connection) -> absl::Status {
          ASSIGN_OR_RETURN(exists, MapExists(connection, entry.id));
          return absl::OkStatus();
        }));
    if (!exists) continue;
    auto map = cache_->Get(entry.map.info, FetchFor(entry));
    if (!map.ok()) {
      return base::Annotate(
          map.status(),
          absl::StrCat(
              "map '", entry.map.name, "' version ", entry.map.version));
    }
    return open_.Add(key, WithGuard(std::move(pin), *std::move(map)));
  }
}

absl::Status PostgresStore::Check(std::string_view name,
                                  std::uint64_t version) {
  ASSIGN_OR_RETURN(const PostgresEntry entry, Find(name, version));
  return base::Annotate(
      cache_->Check(entry.map.info, FetchFor(entry)),
      absl::StrCat("map '", entry.map.name, "' version ", entry.map.version));
}

absl::Status PostgresStore::Delete(std::string_view name) {
  RETURN_IF_ERROR(ValidateStoredName(name));
  std::uint64_t num_deleted = 0;
  bool sent = false;
  RETURN_IF_ERROR(
      pool_.Run([&](PostgresConnection& connection) -> absl::Status {
        const bool again = std::exchange(sent, true);
        ASSIGN_OR_RETURN(num_deleted, DeleteMaps(connection, name));
        // A delete whose answer was lost has done it.
        if (again && num_deleted == 0) num_deleted = 1;
        return absl::OkStatus();
      }));
  return num_deleted == 0 ? NoSuchMap(name, 0) : absl::OkStatus();
}

absl::StatusOr<GarbageReport> PostgresStore::CollectGarbage(
    std::uint64_t keep_newest) {
  RETURN_IF_ERROR(cache_->Sweep());
  RETURN_IF_ERROR(RetryWhileAway([this] { return pins_.Refresh(); }));
  GarbageReport report;
  RETURN_IF_ERROR(pool_.Run([&](PostgresConnection& connection) {
    return connection.Transaction("BEGIN", [&]() -> absl::Status {
      report = {};
      if (keep_newest > 0) {
        ASSIGN_OR_RETURN(report, DeleteOldMaps(connection, keep_newest));
      }
      return CountMaps(connection, report);
    });
  }));
  return report;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenPostgresStore(
    const std::string& url, const CacheOptions& cache_options) {
  RETURN_IF_ERROR(ValidatePostgresUrl(url));
  ASSIGN_OR_RETURN(auto cache, MapCache::Open(cache_options));
  auto store = std::make_unique<PostgresStore>(url, std::move(cache));
  RETURN_IF_ERROR(base::Annotate(store->Prepare(), "store"));
  return store;
}

}  // namespace groundlock::storage::internal
