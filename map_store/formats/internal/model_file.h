// SPDX-License-Identifier: Apache-2.0
// A reconstruction's files, and the memory that what they say takes.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_MODEL_FILE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_MODEL_FILE_H_

#include <cstdint>
#include <filesystem>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mapped_file.h"

namespace groundlock::formats::internal {

enum class ModelFileKind {
  kColmapImages,  // binary, as the other two
  kColmapPoints,
  kColmapCameras,
  kText,            // a record per line or two
  kTextOfFeatures,  // that descriptors are added to which lie elsewhere
  kJson,
};

// Bytes of memory that an import takes for a file with these bytes, at most:
// while it parses, links, and until it has written the map. Measured with files
// of nothing but the shortest records (model_file_test).
std::uint64_t MemoryToImport(std::string_view bytes, ModelFileKind kind);

// What an import may take. Not thread-safe.
class MemoryBudget {
 public:
  // 0 = half of the machine's memory.
  explicit MemoryBudget(std::uint64_t bytes);

  // The file's bytes, mapped: they are no memory of ours. kResourceExhausted
  // says how much the import would take with it; else base::MappedFile's
  // errors.
  absl::StatusOr<base::MappedFile> Open(const std::filesystem::path& path,
                                        ModelFileKind kind);

  // For what is known by the byte. kResourceExhausted as above.
  absl::Status Take(const std::filesystem::path& path, std::uint64_t bytes);

 private:
  std::uint64_t bytes_;
  std::uint64_t taken_bytes_ = 0;
};

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_MODEL_FILE_H_
