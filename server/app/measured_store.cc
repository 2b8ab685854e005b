// SPDX-License-Identifier: Apache-2.0
#include "server/app/measured_store.h"

#include <chrono>
#include <type_traits>
#include <utility>

namespace groundlock::app {
namespace {

using storage::MapVersion;

absl::StatusCode CodeOf(const absl::Status& status) { return status.code(); }
template <typename T>
absl::StatusCode CodeOf(const absl::StatusOr<T>& result) {
  return result.status().code();
}

bool IsFault(absl::StatusCode code) {
  return code == absl::StatusCode::kUnavailable ||
         code == absl::StatusCode::kDataLoss ||
         code == absl::StatusCode::kInternal ||
         code == absl::StatusCode::kUnknown ||
         code == absl::StatusCode::kResourceExhausted;
}

}  // namespace

MeasuredStore::MeasuredStore(std::unique_ptr<storage::Store> store)
    : store_(std::move(store)) {
  operations_[kPublish].name = "publish";
  operations_[kList].name = "list";
  operations_[kGet].name = "get";
  operations_[kOpen].name = "open";
  operations_[kCheck].name = "check";
  operations_[kDelete].name = "delete";
  operations_[kTidy].name = "tidy";
}

template <typename Work>
auto MeasuredStore::Measure(Operation operation,
                            const Work& work,
                            const bool* refused) {
  Measured& measured = operations_[operation];
  const auto start = std::chrono::steady_clock::now();
  auto result = work();
  measured.time.Add(std::chrono::steady_clock::now() - start);
  const bool is_refused = refused != nullptr && *refused;
  if (!is_refused && IsFault(CodeOf(result))) ++measured.failures;
  return result;
}

absl::StatusOr<MapVersion> MeasuredStore::Publish(
    std::string_view name,
    const map::MapData& data,
    const std::function<absl::Status()>& ready) {
  // Whoever is asked whether it still counts may refuse for reasons of its own,
  // which are no faults of the store.
  bool refused = false;
  return Measure(
      kPublish,
      [&] {
        return store_->Publish(name, data, [&ready, &refused] {
          absl::Status status = ready();
          refused = !status.ok();
          return status;
        });
      },
      &refused);
}

absl::StatusOr<std::vector<MapVersion>> MeasuredStore::List() {
  return Measure(kList, [this] { return store_->List(); });
}

absl::StatusOr<std::vector<MapVersion>> MeasuredStore::ListVersions(
    std::string_view name) {
  return Measure(kList, [&] { return store_->ListVersions(name); });
}

absl::StatusOr<MapVersion> MeasuredStore::Get(std::string_view name,
                                              std::uint64_t version) {
  return Measure(kGet, [&] { return store_->Get(name, version); });
}

absl::StatusOr<std::shared_ptr<const map::Map>> MeasuredStore::Open(
    std::string_view name, std::uint64_t version) {
  return Measure(kOpen, [&] { return store_->Open(name, version); });
}

absl::Status MeasuredStore::Check(std::string_view name,
                                  std::uint64_t version) {
  return Measure(kCheck, [&] { return store_->Check(name, version); });
}

absl::Status MeasuredStore::Delete(std::string_view name) {
  return Measure(kDelete, [&] { return store_->Delete(name); });
}

absl::StatusOr<storage::GarbageReport> MeasuredStore::CollectGarbage(
    std::uint64_t keep_newest) {
  return Measure(kTidy, [&] { return store_->CollectGarbage(keep_newest); });
}

}  // namespace groundlock::app
