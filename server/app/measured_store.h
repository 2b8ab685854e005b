// SPDX-License-Identifier: Apache-2.0
// A store whose operations are counted and timed: what the catalogue's
// database, SQLite's or PostgreSQL's, takes as the server sees it.
#ifndef GROUNDLOCK_SERVER_APP_MEASURED_STORE_H_
#define GROUNDLOCK_SERVER_APP_MEASURED_STORE_H_

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "map_store/storage/store.h"
#include "server/service/metrics.h"

namespace groundlock::app {

// Thread-safe, as every store.
class MeasuredStore final : public storage::Store {
 public:
  enum Operation {
    kPublish,
    kList,
    kGet,
    kOpen,
    kCheck,
    kDelete,
    kTidy,
    kNumOperations,
  };
  struct Measured {
    const char* name = "";
    service::DurationHistogram time;
    // Ended because of the store: away, damaged, or not able to. What is merely
    // not there counts as an answer.
    std::atomic<std::uint64_t> failures{0};
  };

  explicit MeasuredStore(std::unique_ptr<storage::Store> store);

  // One for each kind of operation.
  const std::array<Measured, kNumOperations>& operations() const {
    return operations_;
  }

  std::string Description() const override { return store_->Description(); }
  using Store::Publish;
  absl::StatusOr<storage::MapVersion> Publish(
      std::string_view name,
      const map::MapData& data,
      const std::function<absl::Status()>& ready) override;
  absl::StatusOr<std::vector<storage::MapVersion>> List() override;
  absl::StatusOr<std::vector<storage::MapVersion>> ListVersions(
      std::string_view name) override;
  absl::StatusOr<storage::MapVersion> Get(std::string_view name,
                                          std::uint64_t version) override;
  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version) override;
  absl::Status Check(std::string_view name, std::uint64_t version) override;
  absl::Status Delete(std::string_view name) override;
  absl::StatusOr<storage::GarbageReport> CollectGarbage(
      std::uint64_t keep_newest) override;
  storage::StoreStats Stats() const override { return store_->Stats(); }

 private:
  // Runs the operation, which returns a Status or a StatusOr.
  //   refused  true after it if somebody else would not have it
  template <typename Work>
  auto Measure(Operation operation,
               const Work& work,
               const bool* refused = nullptr);

  const std::unique_ptr<storage::Store> store_;
  std::array<Measured, kNumOperations> operations_;
};

}  // namespace groundlock::app

#endif  // GROUNDLOCK_SERVER_APP_MEASURED_STORE_H_
