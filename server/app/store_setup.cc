// SPDX-License-Identifier: Apache-2.0
#include "server/app/store_setup.h"

#include <CLI/CLI.hpp>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::app {

void DefineStoreOptions(CLI::App& app, StoreOptions& options) {
  app.add_option("--store",
                 options.location,
                 "Where maps are kept: a directory, created if absent, or "
                 "postgresql://USER@HOST:PORT/DATABASE")
      ->envname("GROUNDLOCK_STORE")
      ->capture_default_str();
  app.add_option("--map-cache",
                 options.cache.directory,
                 "Directory for maps of a database while they are used")
      ->capture_default_str();
  app.add_option("--map-cache-bytes",
                 options.cache.max_bytes,
                 "Size beyond which the cache drops what was used least "
                 "recently; also as 500MB, 20GB")
      ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
      ->capture_default_str();
  app.add_option("--keep-versions",
                 options.keep_versions,
                 "Versions of a map that are kept, the newest ones and those "
                 "in use; 0 = all")
      ->capture_default_str();
  app.add_flag("--check-store",
               options.check,
               "Read all maps, compare them with their checksums, and exit");
}

absl::StatusOr<std::unique_ptr<storage::Store>> OpenStore(
    const StoreOptions& options) {
  return storage::OpenStore(options.location, options.cache);
}

std::string ScratchDirectory(const StoreOptions& options) {
  const std::filesystem::path parent =
      absl::StrContains(options.location, "://")
          ? options.cache.directory
          : std::filesystem::path(options.location);
  return (parent / "scratch").string();
}

absl::Status CheckStore(storage::Store& store) {
  std::uint64_t num_checked = 0;
  std::uint64_t num_damaged = 0;
  ASSIGN_OR_RETURN(const auto maps, store.List());
  for (const storage::MapVersion& newest : maps) {
    ASSIGN_OR_RETURN(const auto versions, store.ListVersions(newest.name));
    for (const storage::MapVersion& map : versions) {
      const absl::Status status = store.Check(map.name, map.version);
      if (absl::IsUnavailable(status)) return status;
      // Deleted since it was listed.
      if (absl::IsNotFound(status)) continue;
      ++num_checked;
      if (status.ok()) {
        spdlog::info("map {} version {}: whole", map.name, map.version);
        continue;
      }
      ++num_damaged;
      spdlog::error(
          "map {} version {}: {}", map.name, map.version, status.ToString());
    }
  }
  if (num_damaged > 0) {
    return absl::DataLossError(absl::StrCat("store: ",
                                            num_damaged,
                                            " of ",
                                            num_checked,
                                            " map versions are damaged"));
  }
  spdlog::info("store: {} map versions, all whole", num_checked);
  return absl::OkStatus();
}

StoreJanitor::StoreJanitor(storage::Store* store,
                           service::Metrics* metrics,
                           std::uint64_t keep_versions,
                           std::chrono::nanoseconds interval)
    : store_(store),
      metrics_(metrics),
      keep_versions_(keep_versions),
      interval_(interval),
      thread_([this] { Work(); }) {}

StoreJanitor::~StoreJanitor() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  thread_.join();
}

void StoreJanitor::Work() {
  for (;;) {
    const auto report = store_->CollectGarbage(keep_versions_);
    if (!report.ok()) {
      spdlog::warn("store: cannot be tidied: {}", report.status().ToString());
    } else {
      metrics_->maps = report->num_maps;
      metrics_->map_versions = report->num_versions;
      metrics_->map_versions_removed += report->num_removed;
      metrics_->map_versions_in_use = report->num_in_use;
      if (report->num_removed > 0) {
        spdlog::info("store: removed {} old versions, {} more are in use",
                     report->num_removed,
                     report->num_in_use);
      }
    }
    base::MutexLock lock(&mutex_);
    const bool stop = mutex_.AwaitFor(interval_, [this] {
      mutex_.AssertHeld();
      return stopping_;
    });
    if (stop) return;
  }
}

}  // namespace groundlock::app
