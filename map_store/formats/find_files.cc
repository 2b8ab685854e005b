// SPDX-License-Identifier: Apache-2.0
// From what a user typed to the files of a reconstruction.
#include <algorithm>
#include <array>
#include <fstream>

#include "absl/container/flat_hash_set.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/named_files.h"
#include "map_store/formats/internal/source.h"
#include "map_store/formats/internal/text_reader.h"
#include "map_store/formats/photo_readings.h"

namespace groundlock::formats {
namespace internal {
namespace {

namespace fs = std::filesystem;

constexpr char kMapExtension[] = ".glmap";
constexpr char kExpected[] =
    "expected a folder with a COLMAP model, or VisualSFM's .nvm, Bundler's "
    "bundle.out, OpenMVG's sfm_data.json, OpenSfM's reconstruction.json or a "
    ".glmap file";

bool HasExtension(const fs::path& path, std::string_view extension) {
  std::string own = path.extension().string();
  std::transform(own.begin(), own.end(), own.begin(), [](unsigned char c) {
    return static_cast<char>(std::tolower(c));
  });
  return own == extension;
}

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

// What a file is by its name, or by how it starts; kAuto if neither tells.
Format FormatOf(const fs::path& path) {
  if (HasExtension(path, ".nvm")) return Format::kNvm;
  if (HasExtension(path, kMapExtension)) return Format::kGroundlock;
  std::array<char, 256> bytes{};
  std::ifstream stream(path, std::ios::binary);
  stream.read(bytes.data(), bytes.size());
  std::string_view start(bytes.data(),
                         static_cast<std::size_t>(stream.gcount()));
  if (start.starts_with("\x8EGLMAP")) return Format::kGroundlock;
  while (!start.empty() && (IsBlank(start.front()) || start.front() == '\n')) {
    start.remove_prefix(1);
  }
  if (start.starts_with("NVM_V3")) return Format::kNvm;
  if (start.starts_with("# Bundle file")) return Format::kBundler;
  if (HasExtension(path, ".json")) {
    if (start.starts_with("{")) return Format::kOpenMvg;
    if (start.starts_with("[")) return Format::kOpenSfm;
  }
  return Format::kAuto;
}

// The only file of a folder with that extension; kNotFound if there is none,
// kInvalidArgument if there are several.
absl::StatusOr<fs::path> OnlyFileIn(const fs::path& directory,
                                    std::string_view extension) {
  std::vector<fs::path> found;
  std::error_code error;
  for (fs::directory_iterator entry(directory, error), end;
       !error && entry != end;
       entry.increment(error)) {
    if (HasExtension(entry->path(), extension) && IsFile(entry->path())) {
      found.push_back(entry->path());
    }
  }
  if (found.empty()) {
    return absl::NotFoundError(absl::StrCat(
        directory.string(), ": no ", base::Abseil(extension), " file here"));
  }
  if (found.size() > 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(directory.string(),
                     ": holds ",
                     found.size(),
                     " ",
                     base::Abseil(extension),
                     " files; name the one to import"));
  }
  return found.front();
}

// The file of `format` in a folder, where its tool puts it.
absl::StatusOr<fs::path> FindModelFile(const fs::path& directory,
                                       Format format) {
  std::vector<fs::path> candidates;
  switch (format) {
    case Format::kNvm:
      return OnlyFileIn(directory, ".nvm");
    case Format::kGroundlock:
      return OnlyFileIn(directory, kMapExtension);
    case Format::kBundler:
      candidates = {"bundle.out", "bundle/bundle.out"};
      break;
    case Format::kOpenMvg:
      candidates = {"sfm_data.json"};
      break;
    case Format::kOpenSfm:
      candidates = {"reconstruction.json"};
      break;
    case Format::kAuto:
    case Format::kColmap:
      break;
  }
  for (const fs::path& candidate : candidates) {
    if (IsFile(directory / candidate)) return directory / candidate;
  }
  return absl::NotFoundError(
      absl::StrCat(directory.string(),
                   ": no ",
                   candidates.empty() ? "model" : candidates.front().string(),
                   " here"));
}

absl::StatusOr<Source> FindInFolder(const fs::path& path,
                                    const ImportOptions& options,
                                    std::vector<std::string>* warnings) {
  Source source;
  absl::Status none;
  if (options.format == Format::kAuto || options.format == Format::kColmap) {
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
    none = colmap.status();
  }
  for (const Format format : {Format::kNvm,
                              Format::kBundler,
                              Format::kOpenMvg,
                              Format::kOpenSfm,
                              Format::kGroundlock}) {
    if (options.format != Format::kAuto && options.format != format) continue;
    auto file = FindModelFile(path, format);
    if (file.ok()) {
      source.format = format;
      source.file = *std::move(file);
      return source;
    }
    if (options.format == format || !absl::IsNotFound(file.status())) {
      return file.status();
    }
  }
  return absl::NotFoundError(absl::StrCat(
      none.message(), "; nor a file of another format: ", kExpected));
}

}  // namespace

fs::path Source::photo_readings() const {
  return (format == Format::kColmap ? colmap.directory : file.parent_path()) /
         kPhotoReadingsFile;
}

absl::StatusOr<Source> FindSource(const fs::path& path,
                                  const ImportOptions& options,
                                  std::vector<std::string>* warnings) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": no such file or folder"));
  }
  if (fs::is_directory(status)) return FindInFolder(path, options, warnings);
  Source source;
  source.format = options.format;
  if (source.format == Format::kAuto) source.format = FormatOf(path);
  if (source.format == Format::kAuto || source.format == Format::kColmap) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": ", kExpected));
  }
  source.file = path;
  return source;
}

}  // namespace internal

namespace {

namespace fs = std::filesystem;

absl::StatusOr<std::vector<ImportFile>> FindFilesOfImages(
    const internal::Source& source, const fs::path& images) {
  switch (source.format) {
    case Format::kNvm:
      return internal::FindNvmFiles(source.file, images);
    case Format::kBundler:
      return internal::FindBundlerFiles(source.file, images);
    case Format::kOpenMvg:
      return internal::FindOpenMvgFiles(source.file, images);
    case Format::kOpenSfm:
      return internal::FindOpenSfmFiles(source.file, images);
    case Format::kAuto:
    case Format::kColmap:
    case Format::kGroundlock:
      break;
  }
  return std::vector<ImportFile>();
}

}  // namespace

absl::StatusOr<ImportFiles> FindImportFiles(const fs::path& path,
                                            const ImportOptions& options) {
  std::vector<std::string> warnings;  // Import gives them again
  ASSIGN_OR_RETURN(const internal::Source source,
                   internal::FindSource(path, options, &warnings));
  ImportFiles result;
  result.format = source.format;
  std::error_code error;
  if (source.format != Format::kGroundlock &&
      fs::is_regular_file(source.photo_readings(), error)) {
    result.files.push_back({source.photo_readings(), kPhotoReadingsFile});
  }
  if (source.format == Format::kColmap) {
    const internal::ColmapFiles& colmap = source.colmap;
    for (const fs::path& file :
         {colmap.cameras(), colmap.images(), colmap.points()}) {
      result.files.push_back({file, file.filename().string()});
    }
    result.model = ".";
    if (!colmap.database.empty()) {
      result.database = "database.db";
      result.files.push_back({colmap.database, result.database});
    }
    return result;
  }
  result.model = source.file.filename().string();
  result.files.push_back({source.file, result.model});
  ASSIGN_OR_RETURN(const std::vector<ImportFile> of_images,
                   FindFilesOfImages(source, options.images));
  // Two images may lie in one place once their machine's folders are gone.
  absl::flat_hash_set<std::string> taken = {result.model, kPhotoReadingsFile};
  const std::string images_folder = std::string(internal::kImagesFolder) + "/";
  for (const ImportFile& file : of_images) {
    if (!taken.insert(file.remote).second) continue;
    if (file.remote.starts_with(images_folder)) {
      result.images = internal::kImagesFolder;
    }
    result.files.push_back(file);
  }
  return result;
}

}  // namespace groundlock::formats
