// SPDX-License-Identifier: Apache-2.0
// The server's store: its options, and what is done for it beside serving.
#ifndef GROUNDLOCK_SERVER_APP_STORE_SETUP_H_
#define GROUNDLOCK_SERVER_APP_STORE_SETUP_H_

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/storage/store.h"
#include "server/service/metrics.h"

namespace CLI {
class App;
}

namespace groundlock::app {

struct StoreOptions {
  std::string location = "groundlock-store";
  storage::CacheOptions cache;
  std::uint64_t keep_versions = 0;  // of each map; 0 = all
  bool check = false;
};

void DefineStoreOptions(CLI::App& app, StoreOptions& options);

// Errors as of storage::OpenStore; they show no password.
absl::StatusOr<std::unique_ptr<storage::Store>> OpenStore(
    const StoreOptions& options);

// Where uploads and exports lie while they are in progress.
std::string ScratchDirectory(const StoreOptions& options);

// Reads every version of every map and logs what it finds. kDataLoss if any is
// damaged.
absl::Status CheckStore(storage::Store& store);

// Collects the store's garbage now and then, on a thread of its own.
class StoreJanitor {
 public:
  //   store, metrics  must outlive the janitor; it tells what it has found.
  StoreJanitor(storage::Store* store,
               service::Metrics* metrics,
               std::uint64_t keep_versions,
               std::chrono::nanoseconds interval);
  ~StoreJanitor();
  StoreJanitor(const StoreJanitor&) = delete;
  StoreJanitor& operator=(const StoreJanitor&) = delete;

 private:
  void Work();

  storage::Store* const store_;
  service::Metrics* const metrics_;
  const std::uint64_t keep_versions_;
  const std::chrono::nanoseconds interval_;
  base::Mutex mutex_;
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace groundlock::app

#endif  // GROUNDLOCK_SERVER_APP_STORE_SETUP_H_
