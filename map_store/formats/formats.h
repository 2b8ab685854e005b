// SPDX-License-Identifier: Apache-2.0
// Reconstructions of other tools: read into MapData, written from it.
// Everything read is untrusted: counts are checked against the bytes that are
// there before anything is allocated, indices and numbers before they are used.
// Errors name the file and the line, byte offset or field.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_FORMATS_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_FORMATS_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats {

enum class Format {
  kAuto,
  kColmap,
  kNvm,
  kBundler,
  kOpenMvg,
  kOpenSfm,
  kGroundlock  // a map file of ours
};

// "auto", "colmap", "nvm", "bundler", "openmvg", "opensfm", "groundlock";
// kInvalidArgument lists the known names.
absl::StatusOr<Format> FormatFromName(std::string_view name);
std::string_view FormatName(Format format);

struct ImportOptions {
  Format format = Format::kAuto;
  // COLMAP's database; empty = database.db beside or above the model if there.
  std::filesystem::path database;
  // Where images and the files of their features lie, and nowhere else is
  // looked for them but beside the model; empty = where the tools of the format
  // put them, which may be in folders that the model names. Whoever imports
  // for others sets it.
  std::filesystem::path images;
  // What the import may take, as its files tell before they are parsed; 0 =
  // half of the machine's memory.
  std::uint64_t memory_bytes = 0;
  // Asked before each image that is decoded; false ends the import
  // (kCancelled). Null = go on.
  std::function<bool()> go_on;
};

// The files that an import of `path` would read, so that a client can upload
// just these. kNotFound or kInvalidArgument if no known reconstruction is
// there.
//   path  COLMAP: a folder with cameras/images/points3D (.bin or .txt), or one
//         that holds it as sparse/, sparse/0/. Others: the .nvm, bundle.out,
//         sfm_data.json, reconstruction.json or .glmap file, or the folder that
//         holds it.
struct ImportFile {
  std::filesystem::path path;
  std::string remote;  // where Import expects it: relative, '/', no ".."
};
struct ImportFiles {
  Format format = Format::kColmap;
  std::vector<ImportFile> files;
  // Among the remote paths, for Import: `path`, ImportOptions::database and
  // ::images; empty if there is none.
  std::string model;
  std::string database;
  std::string images;
};
absl::StatusOr<ImportFiles> FindImportFiles(const std::filesystem::path& path,
                                            const ImportOptions& options);

// Reads the reconstruction at `path` in its own coordinates (not aligned; those
// of a map file, in_world, are), and its measured_up from what
// kPhotoReadingsFile says beside it, if that is there. kResourceExhausted: it
// would take more than options.memory_bytes. Warnings that a user should see
// (say, a map without descriptors, views that were skipped) are appended to
// `warnings`.
absl::StatusOr<map::MapData> Import(const std::filesystem::path& path,
                                    const ImportOptions& options,
                                    std::vector<std::string>* warnings);

enum class ExportFormat {
  kColmapBinary,
  kColmapText,
  kNvm,
  kPly,
  kGroundlock  // a map file of ours
};
// "colmap", "colmap-text", "nvm", "ply", "groundlock".
absl::StatusOr<ExportFormat> ExportFormatFromName(std::string_view name);

// Writes the map to `path` (a folder for COLMAP: the model and database.db; a
// file for NVM, with its .sift files beside, PLY and a map file). Whole or not
// at all; kAlreadyExists if there is something at `path`. Coordinates are the
// world's. kFailedPrecondition names a camera that the format cannot express;
// if it can only nearly, that is said in `warnings`, if given.
absl::Status Export(const map::MapData& data,
                    ExportFormat format,
                    const std::filesystem::path& path,
                    std::vector<std::string>* warnings = nullptr);

}  // namespace groundlock::formats

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_FORMATS_H_
