// SPDX-License-Identifier: Apache-2.0
// From what a user typed to the files of a reconstruction.
#include <algorithm>

#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/source.h"

namespace groundlock::formats {
namespace internal {
namespace {

namespace fs = std::filesystem;

bool HasNvmExtension(const fs::path& path) {
  const std::string extension = path.extension().string();
  return extension == ".nvm" || extension == ".NVM";
}

// The only .nvm file of a folder; kNotFound if there is none,
// kInvalidArgument if there are several.
absl::StatusOr<fs::path> OnlyNvmIn(const fs::path& directory) {
  std::vector<fs::path> found;
  std::error_code error;
  for (fs::directory_iterator entry(directory, error), end;
       !error && entry != end;
       entry.increment(error)) {
    std::error_code ignored;
    if (HasNvmExtension(entry->path()) && entry->is_regular_file(ignored)) {
      found.push_back(entry->path());
    }
  }
  if (found.empty()) {
    return absl::NotFoundError(
        absl::StrCat(directory.string(), ": no .nvm file here"));
  }
  if (found.size() > 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(directory.string(),
                     ": holds ",
                     found.size(),
                     " .nvm files; name the one to import"));
  }
  return found.front();
}

}  // namespace

absl::StatusOr<Source> FindSource(const fs::path& path,
                                  const ImportOptions& options,
                                  std::vector<std::string>* warnings) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": no such file or folder"));
  }
  Source source;
  if (!fs::is_directory(status)) {
    if (options.format == Format::kColmap ||
        (options.format == Format::kAuto && !HasNvmExtension(path))) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(),
          ": expected a folder with a COLMAP model or an .nvm file"));
    }
    source.format = Format::kNvm;
    source.nvm = path;
    return source;
  }
  if (options.format != Format::kNvm) {
    auto colmap = FindColmapFiles(path, options.database, warnings);
    if (colmap.ok()) {
      source.format = Format::kColmap;
      source.colmap = *std::move(colmap);
      return source;
    }
    if (options.format == Format::kColmap ||
        !absl::IsNotFound(colmap.status())) {
      return colmap.status();
    }
    auto nvm = OnlyNvmIn(path);
    if (absl::IsNotFound(nvm.status())) return colmap.status();
  }
  source.format = Format::kNvm;
  ASSIGN_OR_RETURN(source.nvm, OnlyNvmIn(path));
  return source;
}

}  // namespace internal

namespace {

namespace fs = std::filesystem;

absl::StatusOr<fs::path> Absolute(const fs::path& path) {
  std::error_code error;
  const fs::path canonical = fs::canonical(path, error);
  if (error) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": ", error.message()));
  }
  return canonical;
}

// The deepest folder that holds all of `paths` (absolute).
fs::path CommonFolder(const std::vector<fs::path>& paths) {
  fs::path common = paths.front().parent_path();
  for (const fs::path& path : paths) {
    const auto [end, ignored] =
        std::mismatch(common.begin(), common.end(), path.begin(), path.end());
    fs::path shorter;
    for (auto part = common.begin(); part != end; ++part) shorter /= *part;
    common = shorter;
  }
  return common;
}

std::string Relative(const fs::path& path, const fs::path& root) {
  return path.lexically_relative(root).generic_string();
}

}  // namespace

absl::StatusOr<ImportFiles> FindImportFiles(const fs::path& path,
                                            const ImportOptions& options) {
  std::vector<std::string> warnings;  // Import gives them again
  ASSIGN_OR_RETURN(const internal::Source source,
                   internal::FindSource(path, options, &warnings));
  ImportFiles result;
  result.format = source.format;
  std::vector<fs::path> files;
  fs::path model;
  fs::path database;
  if (source.format == Format::kColmap) {
    const internal::ColmapFiles& colmap = source.colmap;
    ASSIGN_OR_RETURN(model, Absolute(colmap.directory));
    for (const fs::path& file :
         {colmap.cameras(), colmap.images(), colmap.points()}) {
      files.push_back(model / file.filename());
    }
    if (!colmap.database.empty()) {
      ASSIGN_OR_RETURN(database, Absolute(colmap.database));
      files.push_back(database);
    }
  } else {
    ASSIGN_OR_RETURN(model, Absolute(source.nvm));
    files.push_back(model);
    ASSIGN_OR_RETURN(const std::vector<fs::path> sift_files,
                     internal::FindSiftFiles(source.nvm, options.images));
    for (const fs::path& sift : sift_files) {
      ASSIGN_OR_RETURN(files.emplace_back(), Absolute(sift));
    }
  }
  result.root = CommonFolder(files);
  for (const fs::path& file : files) {
    result.files.emplace_back(Relative(file, result.root));
  }
  result.model = Relative(model, result.root);
  if (!database.empty()) result.database = Relative(database, result.root);
  if (!options.images.empty() && source.format == Format::kNvm &&
      files.size() > 1) {
    ASSIGN_OR_RETURN(const fs::path images, Absolute(options.images));
    result.images = Relative(images, result.root);
  }
  return result;
}

}  // namespace groundlock::formats
