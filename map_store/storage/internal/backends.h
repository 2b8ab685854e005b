// SPDX-License-Identifier: Apache-2.0
// The two kinds of store, and what they have in common.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_BACKENDS_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_BACKENDS_H_

#include <filesystem>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/storage/store.h"

namespace groundlock::storage::internal {

absl::StatusOr<std::unique_ptr<Store>> OpenDirectoryStore(
    const std::filesystem::path& root);
absl::StatusOr<std::unique_ptr<Store>> OpenPostgresStore(
    const std::string& url, const CacheOptions& cache);

// version 0 = any.
absl::Status NoSuchMap(std::string_view name, std::uint64_t version);

// kDataLoss unless `map` is the one that the catalogue knows as `expected`.
absl::Status CheckIdentity(const map::Map& map,
                           const map::MapInfo& expected,
                           const std::string& where);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_BACKENDS_H_
