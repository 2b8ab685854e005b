// SPDX-License-Identifier: Apache-2.0
// The bytes of a map file, and the checks of its header.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAPPED_FILE_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAPPED_FILE_H_

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/internal/file_layout.h"

namespace groundlock::map::internal {

struct Mapping {
  const std::byte* data = nullptr;
  std::size_t bytes = 0;
};

// For the caller to unmap. kDataLoss: too short for a header.
absl::StatusOr<Mapping> MapFile(const std::filesystem::path& path);

// kDataLoss, kUnimplemented: as Map::Open.
absl::StatusOr<FileHeader> ReadHeader(const Mapping& mapping);

// [first, first + count) lies in [0, size), without overflow.
inline bool IsRange(std::uint64_t first,
                    std::uint64_t count,
                    std::uint64_t size) {
  return first <= size && count <= size - first;
}

absl::Status Damaged(std::string_view what);  // kDataLoss

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_MAPPED_FILE_H_
