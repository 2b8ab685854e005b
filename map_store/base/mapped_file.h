// SPDX-License-Identifier: Apache-2.0
// A file's bytes in the address space, read when they are looked at: memory
// that the kernel takes back where it needs it.
#ifndef GROUNDLOCK_MAP_STORE_BASE_MAPPED_FILE_H_
#define GROUNDLOCK_MAP_STORE_BASE_MAPPED_FILE_H_

#include <cstdint>
#include <filesystem>
#include <string_view>

#include "absl/status/statusor.h"

namespace groundlock::base {

// Nobody may shorten the file meanwhile: whoever looks at bytes that are gone
// is ended by SIGBUS. Thread-safe.
class MappedFile {
 public:
  // Errors as ReadFile's (file.h).
  static absl::StatusOr<MappedFile> Open(const std::filesystem::path& path,
                                         std::uint64_t max_bytes);
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  ~MappedFile();

  std::string_view bytes() const { return bytes_; }

 private:
  explicit MappedFile(std::string_view bytes) : bytes_(bytes) {}
  std::string_view bytes_;  // empty = nothing is mapped
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_MAPPED_FILE_H_
