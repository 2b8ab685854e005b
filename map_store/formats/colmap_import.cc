// SPDX-License-Identifier: Apache-2.0
// COLMAP: finds the model's files and reads them.
#include <algorithm>
#include <cctype>
#include <filesystem>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

// Fills in directory and binary if a model is right in `directory`.
bool FindModelIn(const fs::path& directory, ColmapFiles* files) {
  for (const bool binary : {true, false}) {
    ColmapFiles candidate;
    candidate.directory = directory;
    candidate.binary = binary;
    if (IsFile(candidate.cameras()) && IsFile(candidate.images()) &&
        IsFile(candidate.points())) {
      *files = candidate;
      return true;
    }
  }
  return false;
}

std::uint64_t ImagesBytes(const ColmapFiles& files) {
  std::error_code error;
  const std::uint64_t size = fs::file_size(files.images(), error);
  return error ? 0 : size;
}

bool IsNumber(const std::string& name) {
  return !name.empty() && name.size() <= 9 &&
         std::all_of(name.begin(), name.end(), [](unsigned char c) {
           return std::isdigit(c) != 0;
         });
}

// COLMAP's mapper writes its sub-models as 0, 1, ...; the largest has the most
// registered images, which images.bin's size tells without reading it.
bool FindLargestSubModel(const fs::path& directory,
                         ColmapFiles* files,
                         std::vector<std::string>* warnings) {
  std::vector<ColmapFiles> models;
  std::error_code error;
  for (fs::directory_iterator entry(directory, error), end;
       !error && entry != end;
       entry.increment(error)) {
    ColmapFiles model;
    if (IsNumber(entry->path().filename().string()) &&
        FindModelIn(entry->path(), &model)) {
      models.push_back(model);
    }
  }
  if (models.empty()) return false;
  std::sort(models.begin(),
            models.end(),
            [](const ColmapFiles& a, const ColmapFiles& b) {
              return a.directory < b.directory;
            });
  *files = *std::max_element(models.begin(),
                             models.end(),
                             [](const ColmapFiles& a, const ColmapFiles& b) {
                               return ImagesBytes(a) < ImagesBytes(b);
                             });
  if (models.size() > 1) {
    warnings->push_back(absl::StrCat(directory.string(),
                                     " holds ",
                                     models.size(),
                                     " models; took the largest, ",
                                     files->directory.filename().string()));
  }
  return true;
}

}  // namespace

absl::StatusOr<ColmapFiles> FindColmapFiles(
    const fs::path& path,
    const fs::path& database,
    std::vector<std::string>* warnings) {
  ColmapFiles files;
  if (!FindModelIn(path, &files) && !FindModelIn(path / "sparse", &files) &&
      !FindLargestSubModel(path / "sparse", &files, warnings) &&
      !FindLargestSubModel(path, &files, warnings)) {
    return absl::NotFoundError(absl::StrCat(
        path.string(),
        ": no COLMAP model here (cameras, images and points3D, .bin or .txt, "
        "in the folder itself, in sparse/ or in sparse/0/)"));
  }
  if (!database.empty()) {
    files.database = database;
    if (!IsFile(database)) {
      return absl::NotFoundError(
          absl::StrCat(database.string(), ": no such database file"));
    }
    return files;
  }
  // "a/b/" has an empty file name and itself as parent: normalise first.
  std::error_code error;
  fs::path directory = fs::absolute(files.directory, error).lexically_normal();
  if (!directory.has_filename()) directory = directory.parent_path();
  for (int level = 0; level < 3; ++level) {
    if (IsFile(directory / "database.db")) {
      files.database = directory / "database.db";
      break;
    }
    directory = directory.parent_path();
  }
  return files;
}

absl::StatusOr<map::MapData> ImportColmap(const ColmapFiles& files,
                                          bool database_required,
                                          MemoryBudget& budget,
                                          std::vector<std::string>* warnings) {
  using Parser =
      absl::Status (*)(std::string_view, std::string_view, ColmapModel*);
  struct Part {
    fs::path path;
    Parser parse;
    ModelFileKind kind;
  };
  const std::array<Part, 3> parts = {
      Part{files.cameras(),
           files.binary ? ParseColmapCamerasBinary : ParseColmapCamerasText,
           ModelFileKind::kColmapCameras},
      Part{files.images(),
           files.binary ? ParseColmapImagesBinary : ParseColmapImagesText,
           ModelFileKind::kColmapImages},
      Part{files.points(),
           files.binary ? ParseColmapPointsBinary : ParseColmapPointsText,
           ModelFileKind::kColmapPoints}};
  ColmapModel model;
  for (const Part& part : parts) {
    ASSIGN_OR_RETURN(
        const base::MappedFile file,
        budget.Open(part.path,
                    files.binary ? part.kind : ModelFileKind::kText));
    RETURN_IF_ERROR(part.parse(file.bytes(), part.path.string(), &model));
  }
  auto linked = LinkColmapModel(std::move(model), warnings);
  if (!linked.ok()) {
    return base::Annotate(linked.status(), files.directory.string());
  }
  if (linked->data.views.empty() || linked->data.landmarks.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(files.directory.string(),
                     ": the model is empty: ",
                     linked->data.views.size(),
                     " images, ",
                     linked->data.landmarks.size(),
                     " points"));
  }
  if (files.database.empty()) {
    warnings->push_back(
        "no database.db beside the model: the map has no descriptors, so no "
        "camera can be found in it");
    return std::move(linked->data);
  }
  std::vector<std::string> lacking;
  std::uint64_t num_features = 0;
  for (const map::MapViewData& view : linked->data.views) {
    num_features += view.keypoints_px.size();
  }
  RETURN_IF_ERROR(
      budget.Take(files.database, num_features * sizeof(map::Descriptor)));
  RETURN_IF_ERROR(ReadColmapDescriptors(files.database, &*linked, &lacking));
  SettleDescriptors(lacking, files.database.string(), &linked->data, warnings);
  if (database_required && !linked->data.has_descriptors()) {
    return absl::FailedPreconditionError(
        absl::StrCat(files.database.string(),
                     ": this database does not belong to the model: ",
                     warnings->empty() ? "" : warnings->back()));
  }
  return std::move(linked->data);
}

}  // namespace groundlock::formats::internal
