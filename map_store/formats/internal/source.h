// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SOURCE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SOURCE_H_

#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/internal/importers.h"

namespace groundlock::formats::internal {

// What a user's path turned out to be.
struct Source {
  Format format = Format::kColmap;  // never kAuto
  ColmapFiles colmap;               // if kColmap
  std::filesystem::path file;       // of all others

  // Where PhotoReadings may lie beside the model.
  std::filesystem::path photo_readings() const;
};

// kNotFound if there is nothing at `path` or nothing that options.format
// allows.
absl::StatusOr<Source> FindSource(const std::filesystem::path& path,
                                  const ImportOptions& options,
                                  std::vector<std::string>* warnings);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_SOURCE_H_
