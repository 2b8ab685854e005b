// SPDX-License-Identifier: Apache-2.0
// What Import, Export and FindImportFiles dispatch to; one file per format.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMPORTERS_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMPORTERS_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/model_file.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

// Where a COLMAP model's three files are.
struct ColmapFiles {
  std::filesystem::path directory;
  bool binary = true;
  std::filesystem::path database;  // empty if there is none
  std::filesystem::path cameras() const { return File("cameras"); }
  std::filesystem::path images() const { return File("images"); }
  std::filesystem::path points() const { return File("points3D"); }

 private:
  std::filesystem::path File(const char* stem) const {
    return directory / (std::string(stem) + (binary ? ".bin" : ".txt"));
  }
};

// The model in `path`, `path`/sparse or one of their numbered sub-folders (the
// one with the largest images file, with a warning), binary before text; the
// database as ImportOptions says. kNotFound if there is no model.
absl::StatusOr<ColmapFiles> FindColmapFiles(
    const std::filesystem::path& path,
    const std::filesystem::path& database,
    std::vector<std::string>* warnings);
absl::StatusOr<map::MapData> ImportColmap(const ColmapFiles& files,
                                          bool database_required,
                                          MemoryBudget& budget,
                                          std::vector<std::string>* warnings);

// Fills in the descriptors of `linked` from COLMAP's database (opened
// read-only; images are found by name). Views whose features the database does
// not have keep none; their names come back in `lacking`.
absl::Status ReadColmapDescriptors(const std::filesystem::path& database,
                                   LinkedModel* linked,
                                   std::vector<std::string>* lacking);

// A map has descriptors for all features or for none. If at least half of the
// features have them, the features of the views in `lacking` go (views stay, as
// poses); otherwise all descriptors go. Says so in `warnings`.
void SettleDescriptors(const std::vector<std::string>& lacking,
                       std::string_view source,
                       map::MapData* data,
                       std::vector<std::string>* warnings);

// NVM: `path` is the file; `images` where images or .sift files lie.
absl::StatusOr<map::MapData> ImportNvm(const std::filesystem::path& path,
                                       const std::filesystem::path& images,
                                       MemoryBudget& budget,
                                       std::vector<std::string>* warnings);
// The .sift files that ImportNvm would read, and images where there is none.
absl::StatusOr<std::vector<ImportFile>> FindNvmFiles(
    const std::filesystem::path& path, const std::filesystem::path& images);

// Bundler: `path` is bundle.out; OpenMVG: sfm_data.json; OpenSfM:
// reconstruction.json. `images` as in ImportOptions. The others are the files
// that an import would read besides it, each with its place below kImagesFolder
// (or beside the model).
absl::StatusOr<map::MapData> ImportBundler(const std::filesystem::path& path,
                                           const std::filesystem::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings);
absl::StatusOr<std::vector<ImportFile>> FindBundlerFiles(
    const std::filesystem::path& path, const std::filesystem::path& images);
absl::StatusOr<map::MapData> ImportOpenMvg(const std::filesystem::path& path,
                                           const std::filesystem::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings);
absl::StatusOr<std::vector<ImportFile>> FindOpenMvgFiles(
    const std::filesystem::path& path, const std::filesystem::path& images);
absl::StatusOr<map::MapData> ImportOpenSfm(const std::filesystem::path& path,
                                           const std::filesystem::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings);
absl::StatusOr<std::vector<ImportFile>> FindOpenSfmFiles(
    const std::filesystem::path& path, const std::filesystem::path& images);

// A map file of ours, verified.
absl::StatusOr<map::MapData> ImportMapFile(const std::filesystem::path& path);

absl::Status ExportColmap(const map::MapData& data,
                          bool binary,
                          const std::filesystem::path& path);
absl::Status WriteColmapDatabase(const map::MapData& data,
                                 const std::filesystem::path& path);
absl::Status ExportNvm(const map::MapData& data,
                       const std::filesystem::path& path,
                       std::vector<std::string>* warnings);
absl::Status ExportPly(const map::MapData& data,
                       const std::filesystem::path& path);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_IMPORTERS_H_
