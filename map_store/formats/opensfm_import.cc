// SPDX-License-Identifier: Apache-2.0
// OpenSfM: reconstruction.json, with tracks.csv and images/ beside it. Its
// features' files are not used: by default they describe affine regions, which
// no camera's SIFT matches.
#include <algorithm>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/formats/internal/named_files.h"
#include "map_store/formats/internal/opensfm_model.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> Folders(const fs::path& path, const fs::path& images) {
  if (!images.empty()) return {images, images / "images"};
  return {FolderOf(path) / "images", FolderOf(path)};
}

// tracks.csv, or tracks_x.csv for reconstruction_x.json.
absl::StatusOr<fs::path> FindTracks(const fs::path& path) {
  std::string own = path.stem().string();
  const std::size_t at = own.find("reconstruction");
  std::vector<fs::path> candidates;
  if (at != std::string::npos) {
    own.replace(at, std::string_view("reconstruction").size(), "tracks");
    candidates.push_back(FolderOf(path) / (own + ".csv"));
  }
  candidates.push_back(FolderOf(path) / "tracks.csv");
  for (const fs::path& candidate : candidates) {
    std::error_code error;
    if (fs::is_regular_file(candidate, error)) return candidate;
  }
  return absl::NotFoundError(
      absl::StrCat(candidates.front().string(),
                   ": not there; it says where the points are seen"));
}

absl::StatusOr<OpenSfmModel> ReadOpenSfm(const fs::path& path,
                                         MemoryBudget& budget) {
  ASSIGN_OR_RETURN(const base::MappedFile text,
                   budget.Open(path, ModelFileKind::kJson));
  return ParseOpenSfm(text.bytes(), path.string());
}

absl::StatusOr<map::MapData> Link(
    const OpenSfmModel& model,
    const std::vector<OpenSfmObservation>& observations,
    std::vector<ViewImage>* images) {
  map::MapData data;
  data.source_format = "opensfm";
  data.cameras = model.cameras;
  data.landmarks = model.points;
  data.origin = model.reference;
  data.metric = model.reference.has_value();
  std::vector<std::string> names;
  for (const OpenSfmShot& shot : model.shots) names.push_back(shot.image);
  ASSIGN_OR_RETURN(const std::vector<std::string> short_names,
                   ViewNames(names));
  for (std::size_t i = 0; i < model.shots.size(); ++i) {
    map::MapViewData& view = data.views.emplace_back();
    view.name = short_names[i];
    view.camera = model.shots[i].camera;
    view.camera_from_world = model.shots[i].camera_from_world;
  }
  images->resize(data.views.size());
  for (const OpenSfmObservation& o : observations) {
    map::MapViewData& view = data.views[o.shot];
    const geometry::CameraModel& camera = data.cameras[view.camera];
    const double side_px = std::max(camera.width_px(), camera.height_px());
    // Normalised coordinates are from the middle between the first pixel's
    // centre and the last one's: the image's centre.
    const Eigen::Vector2d xy_px =
        side_px * o.xy_normalized +
        0.5 * Eigen::Vector2d(camera.width_px(), camera.height_px());
    view.keypoints_px.push_back(xy_px.cast<float>());
    view.landmarks.push_back(o.point);
    if (o.size_normalized > 0.0) {
      (*images)[o.shot].sizes_px.push_back(
          static_cast<float>(side_px * o.size_normalized));
    }
  }
  for (std::size_t i = 0; i < images->size(); ++i) {
    std::vector<float>& sizes_px = (*images)[i].sizes_px;
    if (sizes_px.size() != data.views[i].keypoints_px.size()) sizes_px.clear();
  }
  return data;
}

}  // namespace

absl::StatusOr<map::MapData> ImportOpenSfm(const fs::path& path,
                                           const fs::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings) {
  ASSIGN_OR_RETURN(const OpenSfmModel model, ReadOpenSfm(path, budget));
  warnings->insert(
      warnings->end(), model.warnings.begin(), model.warnings.end());
  if (model.num_models > 1) {
    warnings->push_back(absl::StrCat(path.string(),
                                     " holds ",
                                     model.num_models,
                                     " reconstructions; took the largest, of ",
                                     model.shots.size(),
                                     " images"));
  }
  ASSIGN_OR_RETURN(const fs::path tracks, FindTracks(path));
  ASSIGN_OR_RETURN(const base::MappedFile text,
                   budget.Open(tracks, ModelFileKind::kText));
  ASSIGN_OR_RETURN(const std::vector<OpenSfmObservation> observations,
                   ParseOpenSfmTracks(text.bytes(), tracks.string(), model));
  if (observations.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(tracks.string(),
                     ": holds no track of a point of ",
                     path.string(),
                     ": the two are not of one reconstruction"));
  }
  std::vector<ViewImage> view_images;
  auto data = Link(model, observations, &view_images);
  if (!data.ok()) return base::Annotate(data.status(), path.string());
  const std::vector<fs::path> folders = Folders(path, images);
  for (std::size_t i = 0; i < view_images.size(); ++i) {
    const auto image = FindNamedFile(folders, model.shots[i].image);
    if (image) view_images[i].path = *image;
  }
  std::vector<std::string> lacking;
  RETURN_IF_ERROR(
      DescribeFromImages(view_images, go_on, &*data, &lacking, warnings));
  SettleDescriptors(
      lacking, absl::StrCat(path.string(), " (images)"), &*data, warnings);
  return data;
}

absl::StatusOr<std::vector<ImportFile>> FindOpenSfmFiles(
    const fs::path& path, const fs::path& images) {
  MemoryBudget budget(0);
  ASSIGN_OR_RETURN(const OpenSfmModel model, ReadOpenSfm(path, budget));
  ASSIGN_OR_RETURN(const fs::path tracks, FindTracks(path));
  std::vector<ImportFile> files = {{tracks, tracks.filename().string()}};
  for (const OpenSfmShot& shot : model.shots) {
    if (const auto image = FindNamedFile(Folders(path, images), shot.image)) {
      files.push_back({*image, RemoteName(shot.image)});
    }
  }
  return files;
}

}  // namespace groundlock::formats::internal
