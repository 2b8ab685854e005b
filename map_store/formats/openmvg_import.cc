// SPDX-License-Identifier: Apache-2.0
// OpenMVG: sfm_data.json, with images or .feat and .desc files around it.
#include <algorithm>
#include <tuple>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/descriptors.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/formats/internal/named_files.h"
#include "map_store/formats/internal/openmvg_model.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMaxFeatureFileBytes = std::uint64_t{256} << 20;
// Observations are the features' places to their printed digits.
constexpr float kFeatTolerance_px = 0.1F;

// The images lie where OpenMVG found them; features beside the reconstruction
// or in the folder of the matches that its own scripts make.
std::vector<fs::path> Folders(const fs::path& path,
                              const fs::path& images,
                              const std::string& root_path) {
  if (!images.empty()) return {images, FolderOf(path)};
  const fs::path folder = FolderOf(path);
  std::vector<fs::path> folders = {folder};
  if (!root_path.empty()) folders.push_back(folder / root_path);
  folders.push_back(folder / ".." / "matches");
  folders.push_back(folder / "..");
  return folders;
}

// RootSIFT is OpenMVG's default; image_describer.json beside the features says
// what was used. Both have 512 as their Euclidean norm, so the numbers do not.
bool IsRootSift(std::span<const fs::path> folders) {
  const auto path = FindNamedFile(folders, "image_describer.json");
  if (!path) return true;
  const auto text = base::ReadFile(*path, std::uint64_t{1} << 20);
  if (!text.ok()) return true;
  const std::size_t at = text->find("\"root_sift\"");
  if (at == std::string::npos) return true;
  return text->find("false", at) > text->find_first_of(",}", at);
}

struct FeatureFiles {
  fs::path feat;
  fs::path desc;
};

std::optional<FeatureFiles> FindFeatures(std::span<const fs::path> folders,
                                         const std::string& image) {
  const auto feat = FindNamedFile(folders, image, ".feat");
  const auto desc = FindNamedFile(folders, image, ".desc");
  if (!feat || !desc) return std::nullopt;
  return FeatureFiles{*feat, *desc};
}

// Descriptors of one view's observations; none if the files are not of them.
absl::Status ReadDescriptors(const FeatureFiles& files,
                             std::span<const OpenMvgObservation> observations,
                             bool is_root_sift,
                             map::MapViewData* view) {
  ASSIGN_OR_RETURN(const std::string text,
                   base::ReadFile(files.feat, kMaxFeatureFileBytes));
  ASSIGN_OR_RETURN(const FeatFile features,
                   ParseFeatFile(text, files.feat.string()));
  ASSIGN_OR_RETURN(const std::string bytes,
                   base::ReadFile(files.desc, kMaxFeatureFileBytes));
  ASSIGN_OR_RETURN(const auto descriptors,
                   ParseDescFile(bytes, files.desc.string()));
  if (features.xy_px.size() != descriptors.size()) return absl::OkStatus();
  std::size_t num_agreeing = 0;
  for (const OpenMvgObservation& o : observations) {
    if (o.feature >= descriptors.size()) return absl::OkStatus();
    if ((features.xy_px[o.feature] - o.xy_px).norm() < kFeatTolerance_px) {
      ++num_agreeing;
    }
  }
  if (num_agreeing * 10 < observations.size() * 9) return absl::OkStatus();
  view->descriptors.reserve(observations.size());
  for (const OpenMvgObservation& o : observations) {
    const map::Descriptor sift =
        ReorderOpenMvgDescriptor(descriptors[o.feature]);
    view->descriptors.push_back(is_root_sift ? sift : RootSiftFromSift(sift));
  }
  return absl::OkStatus();
}

class OpenMvgImporter {
 public:
  OpenMvgImporter(OpenMvgModel model,
                  std::vector<fs::path> folders,
                  std::function<bool()> go_on,
                  std::vector<std::string>* warnings)
      : model_(std::move(model)),
        folders_(std::move(folders)),
        go_on_(std::move(go_on)),
        warnings_(warnings) {}

  absl::StatusOr<map::MapData> Run(const std::string& source);

 private:
  std::span<const OpenMvgObservation> ObservationsOf(std::size_t view) const {
    return std::span(model_.observations)
        .subspan(first_[view], first_[view + 1] - first_[view]);
  }
  absl::Status MakeViews();
  absl::Status Describe(std::vector<std::string>* lacking);

  OpenMvgModel model_;
  std::vector<fs::path> folders_;
  const std::function<bool()> go_on_;
  std::vector<std::string>* warnings_;
  map::MapData data_;
  std::vector<std::size_t> first_;  // observation of each view, and the end
};

absl::Status OpenMvgImporter::MakeViews() {
  std::vector<OpenMvgObservation>& all = model_.observations;
  std::sort(all.begin(),
            all.end(),
            [](const OpenMvgObservation& a, const OpenMvgObservation& b) {
              return std::tie(a.view, a.feature, a.point) <
                     std::tie(b.view, b.feature, b.point);
            });
  first_.assign(model_.views.size() + 1, 0);
  for (const OpenMvgObservation& o : all) ++first_[o.view + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];

  std::vector<std::string> images;
  for (const OpenMvgView& view : model_.views) images.push_back(view.image);
  ASSIGN_OR_RETURN(const std::vector<std::string> names, ViewNames(images));
  for (std::size_t v = 0; v < model_.views.size(); ++v) {
    map::MapViewData& view = data_.views.emplace_back();
    view.name = names[v];
    view.camera = model_.views[v].camera;
    view.camera_from_world = model_.views[v].camera_from_world;
    for (const OpenMvgObservation& o : ObservationsOf(v)) {
      view.keypoints_px.push_back(o.xy_px);
      view.landmarks.push_back(o.point);
    }
  }
  return absl::OkStatus();
}

// From the images where they are there: the same SIFT then describes the map
// and what is looked up in it. Else from OpenMVG's own files.
absl::Status OpenMvgImporter::Describe(std::vector<std::string>* lacking) {
  std::vector<ViewImage> images(data_.views.size());
  bool any_image = false;
  for (std::size_t v = 0; v < images.size(); ++v) {
    const auto image = FindNamedFile(folders_, model_.views[v].image);
    if (!image) continue;
    images[v].path = *image;
    any_image = true;
  }
  if (any_image) {
    return DescribeFromImages(images, go_on_, &data_, lacking, warnings_);
  }
  const bool is_root_sift = IsRootSift(folders_);
  for (std::size_t v = 0; v < data_.views.size(); ++v) {
    map::MapViewData& view = data_.views[v];
    if (view.keypoints_px.empty()) continue;
    const auto files = FindFeatures(folders_, model_.views[v].image);
    if (files) {
      RETURN_IF_ERROR(
          ReadDescriptors(*files, ObservationsOf(v), is_root_sift, &view));
    }
    if (view.descriptors.empty()) lacking->push_back(view.name);
  }
  return absl::OkStatus();
}

absl::StatusOr<map::MapData> OpenMvgImporter::Run(const std::string& source) {
  if (model_.views.empty() || model_.points.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("the model is empty: ",
                                                   model_.views.size(),
                                                   " views with a pose, ",
                                                   model_.points.size(),
                                                   " points"));
  }
  data_.source_format = "openmvg";
  data_.cameras = std::move(model_.cameras);
  data_.landmarks = std::move(model_.points);
  RETURN_IF_ERROR(MakeViews());
  std::vector<std::string> lacking;
  RETURN_IF_ERROR(Describe(&lacking));
  SettleDescriptors(lacking,
                    absl::StrCat(source, " (images, or .feat and .desc files)"),
                    &data_,
                    warnings_);
  return std::move(data_);
}

absl::StatusOr<OpenMvgModel> ReadOpenMvg(const fs::path& path,
                                         MemoryBudget& budget) {
  ASSIGN_OR_RETURN(const base::MappedFile text,
                   budget.Open(path, ModelFileKind::kJson));
  return ParseOpenMvg(text.bytes(), path.string());
}

}  // namespace

absl::StatusOr<map::MapData> ImportOpenMvg(const fs::path& path,
                                           const fs::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings) {
  ASSIGN_OR_RETURN(OpenMvgModel model, ReadOpenMvg(path, budget));
  warnings->insert(
      warnings->end(), model.warnings.begin(), model.warnings.end());
  std::vector<fs::path> folders = Folders(path, images, model.root_path);
  OpenMvgImporter importer(
      std::move(model), std::move(folders), go_on, warnings);
  auto data = importer.Run(path.string());
  if (!data.ok()) return base::Annotate(data.status(), path.string());
  return data;
}

absl::StatusOr<std::vector<ImportFile>> FindOpenMvgFiles(
    const fs::path& path, const fs::path& images) {
  MemoryBudget budget(0);
  ASSIGN_OR_RETURN(const OpenMvgModel model, ReadOpenMvg(path, budget));
  const std::vector<fs::path> folders = Folders(path, images, model.root_path);
  std::vector<ImportFile> files;
  std::vector<ImportFile> features;
  for (const OpenMvgView& view : model.views) {
    if (const auto image = FindNamedFile(folders, view.image)) {
      files.push_back({*image, RemoteName(view.image)});
    }
    if (const auto found = FindFeatures(folders, view.image)) {
      features.push_back({found->feat, RemoteName(view.image, ".feat")});
      features.push_back({found->desc, RemoteName(view.image, ".desc")});
    }
  }
  if (!files.empty() || features.empty()) return files;
  if (const auto describer = FindNamedFile(folders, "image_describer.json")) {
    features.push_back(
        {*describer, absl::StrCat(kImagesFolder, "/image_describer.json")});
  }
  return features;
}

}  // namespace groundlock::formats::internal
