// SPDX-License-Identifier: Apache-2.0
// A file of tokens: entries that are whole, or an error.
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "map_store/base/token_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  static const auto* const path =
      new std::filesystem::path(std::filesystem::temp_directory_path() /
                                ("tokens-" + std::to_string(getpid())));
  std::ofstream(*path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data),
             static_cast<std::streamsize>(size));
  std::filesystem::permissions(
      *path,
      std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  const auto file = groundlock::base::ReadTokenFile(*path);
  if (!file.ok()) return 0;
  for (const auto& entry : file->entries) {
    if (entry.name.empty() || entry.scopes.empty() ||
        entry.credential.empty()) {
      __builtin_trap();
    }
  }
  return 0;
}
