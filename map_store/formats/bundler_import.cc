// SPDX-License-Identifier: Apache-2.0
// Bundler: bundle.out, with list.txt, .key files and images around it.
#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/bundler_model.h"
#include "map_store/formats/internal/descriptors.h"
#include "map_store/formats/internal/image_size.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/named_files.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;
using geometry::CameraModel;
using geometry::CameraModelId;

// An image of tens of thousands of keypoints takes some 10 MB of text.
constexpr std::uint64_t kMaxKeyFileBytes = std::uint64_t{256} << 20;
// Measurements are the keypoints' places less one offset per image, printed to
// 1e-4 px: anything beyond this is another file.
constexpr double kKeyTolerance_px = 0.1;

bool IsImage(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(),
                 extension.end(),
                 extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension == ".jpg" || extension == ".jpeg" || extension == ".png";
}

std::vector<std::string> ImagesIn(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    std::error_code ignored;
    if (IsImage(entry->path()) && entry->is_regular_file(ignored)) {
      names.push_back(entry->path().filename().string());
    }
  }
  std::sort(names.begin(), names.end());
  return names;
}

struct ImageList {
  std::vector<std::string> names;  // one per camera; empty = not known
  fs::path file;                   // list.txt; empty = there is none
  bool guessed = false;            // from the folder's content
};

// list.txt; or, as Bundler's script makes it of all images of a folder, the
// images of the only folder that holds as many as there are cameras.
absl::StatusOr<ImageList> FindList(std::span<const fs::path> folders,
                                   std::size_t num_cameras,
                                   MemoryBudget& budget) {
  ImageList list;
  for (const fs::path& folder : folders) {
    const fs::path file = folder / "list.txt";
    std::error_code error;
    if (!fs::is_regular_file(file, error)) continue;
    ASSIGN_OR_RETURN(const base::MappedFile text,
                     budget.Open(file, ModelFileKind::kText));
    ASSIGN_OR_RETURN(list.names, ParseBundlerList(text.bytes(), file.string()));
    if (list.names.size() != num_cameras) {
      return absl::InvalidArgumentError(absl::StrCat(file.string(),
                                                     " names ",
                                                     list.names.size(),
                                                     " images, the model has ",
                                                     num_cameras,
                                                     " cameras"));
    }
    list.file = file;
    return list;
  }
  for (const fs::path& folder : folders) {
    std::vector<std::string> names = ImagesIn(folder);
    if (names.size() != num_cameras) continue;
    list.names = std::move(names);
    list.guessed = true;
    return list;
  }
  return list;
}

std::optional<fs::path> FindKeys(std::span<const fs::path> folders,
                                 const std::string& name) {
  auto keys = FindNamedFile(folders, name, ".key");
  return keys ? keys : FindNamedFile(folders, name, ".key.gz");
}

absl::StatusOr<KeyFile> ReadKeys(const fs::path& path) {
  ASSIGN_OR_RETURN(std::string bytes, base::ReadFile(path, kMaxKeyFileBytes));
  if (path.extension() == ".gz") {
    ASSIGN_OR_RETURN(bytes, Gunzip(bytes, kMaxKeyFileBytes, path.string()));
  }
  return ParseKeyFile(bytes, path.string());
}

// The offset from an image's measurements to its keypoints, if they belong
// together: half its size less half a pixel.
std::optional<Eigen::Vector2d> KeyOffset(
    std::span<const BundlerObservation> observations, const KeyFile& keys) {
  std::array<std::vector<double>, 2> deltas;
  for (const BundlerObservation& o : observations) {
    if (o.key >= keys.xy_px.size()) return std::nullopt;
    for (int axis = 0; axis < 2; ++axis) {
      deltas[static_cast<std::size_t>(axis)].push_back(
          static_cast<double>(keys.xy_px[o.key](axis)) - o.xy_px(axis));
    }
  }
  if (observations.empty()) return std::nullopt;
  Eigen::Vector2d offset;
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double>& values = deltas[static_cast<std::size_t>(axis)];
    const auto middle =
        values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    offset(axis) = std::round(2.0 * *middle) / 2.0;
  }
  std::size_t num_agreeing = 0;
  for (const BundlerObservation& o : observations) {
    const Eigen::Vector2d delta =
        (keys.xy_px[o.key] - o.xy_px).cast<double>() - offset;
    if (delta.norm() < kKeyTolerance_px) ++num_agreeing;
  }
  if (num_agreeing * 10 < observations.size() * 9) return std::nullopt;
  return offset;
}

class BundlerImporter {
 public:
  BundlerImporter(BundlerModel model,
                  ImageList list,
                  std::vector<fs::path> folders,
                  std::function<bool()> go_on,
                  std::vector<std::string>* warnings)
      : model_(std::move(model)),
        list_(std::move(list)),
        folders_(std::move(folders)),
        go_on_(std::move(go_on)),
        warnings_(warnings) {}

  absl::StatusOr<map::MapData> Run(const std::string& source);

 private:
  std::span<const BundlerObservation> ObservationsOf(std::size_t camera) const {
    return std::span(model_.observations)
        .subspan(first_[camera], first_[camera + 1] - first_[camera]);
  }
  void SortObservations();
  absl::Status MakeViews();
  absl::Status ReadKeyFiles(std::vector<std::string>* lacking);
  void ChooseSizes();
  absl::Status MakeCameras();
  absl::Status Describe(std::vector<std::string>* lacking);

  BundlerModel model_;
  ImageList list_;
  std::vector<fs::path> folders_;
  const std::function<bool()> go_on_;
  std::vector<std::string>* warnings_;
  map::MapData data_;
  std::vector<std::size_t> first_;      // observation of each camera, and end
  std::vector<std::size_t> camera_of_;  // per view: index in model_.cameras
  std::vector<std::optional<fs::path>> images_;  // per view
  std::vector<std::optional<ImageSize>> sizes_;  // per view
};

void BundlerImporter::SortObservations() {
  std::vector<BundlerObservation>& all = model_.observations;
  std::sort(all.begin(),
            all.end(),
            [](const BundlerObservation& a, const BundlerObservation& b) {
              return std::tie(a.camera, a.key, a.point) <
                     std::tie(b.camera, b.key, b.point);
            });
  first_.assign(model_.cameras.size() + 1, 0);
  for (const BundlerObservation& o : all) ++first_[o.camera + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
}

absl::Status BundlerImporter::MakeViews() {
  std::vector<std::string> names = list_.names;
  if (names.empty()) {
    for (std::size_t i = 0; i < model_.cameras.size(); ++i) {
      names.push_back(absl::StrCat("camera ", i));
    }
    warnings_->push_back(
        "there is no list.txt beside the model: images have no names");
  } else if (list_.guessed) {
    warnings_->push_back(
        "there is no list.txt beside the model; took the images of the folder "
        "in the order of their names");
  }
  ASSIGN_OR_RETURN(const std::vector<std::string> short_names,
                   ViewNames(names));
  for (std::size_t i = 0; i < model_.cameras.size(); ++i) {
    const BundlerCamera& camera = model_.cameras[i];
    if (camera.focal_px == 0.0) {
      if (!ObservationsOf(i).empty()) {
        return absl::InvalidArgumentError(absl::StrCat(
            "camera ", i, " was not registered, but points are seen in it"));
      }
      continue;
    }
    camera_of_.push_back(i);
    map::MapViewData& view = data_.views.emplace_back();
    view.name = short_names[i];
    view.camera_from_world = camera.camera_from_world;
    std::optional<fs::path>& image = images_.emplace_back();
    std::optional<ImageSize>& size = sizes_.emplace_back();
    if (list_.names.empty()) continue;
    image = FindNamedFile(folders_, names[i]);
    if (image) size = ReadImageSize(*image);
  }
  if (data_.views.empty()) {
    return absl::InvalidArgumentError("the model has no registered camera");
  }
  if (data_.views.size() < model_.cameras.size()) {
    warnings_->push_back(
        absl::StrCat("Bundler registered ",
                     data_.views.size(),
                     " of the model's ",
                     model_.cameras.size(),
                     " images; the others are not in the map"));
  }
  return absl::OkStatus();
}

absl::Status BundlerImporter::ReadKeyFiles(std::vector<std::string>* lacking) {
  for (std::size_t v = 0; v < data_.views.size(); ++v) {
    map::MapViewData& view = data_.views[v];
    const auto observations = ObservationsOf(camera_of_[v]);
    if (observations.empty()) continue;
    std::optional<fs::path> path;
    if (!list_.names.empty()) {
      path = FindKeys(folders_, list_.names[camera_of_[v]]);
    }
    if (!path) {
      lacking->push_back(view.name);
      continue;
    }
    ASSIGN_OR_RETURN(const KeyFile keys, ReadKeys(*path));
    const auto offset = KeyOffset(observations, keys);
    if (!offset) {
      lacking->push_back(view.name);
      continue;
    }
    const Eigen::Vector2d size = (2.0 * *offset).array() + 1.0;  // of the image
    if (!sizes_[v] && size.minCoeff() >= 1.0 &&
        size.maxCoeff() <= CameraModel::kMaxSizePx) {
      sizes_[v] =
          ImageSize{static_cast<int>(size.x()), static_cast<int>(size.y())};
    }
    view.descriptors.reserve(observations.size());
    for (const BundlerObservation& o : observations) {
      view.descriptors.push_back(RootSiftFromSift(keys.descriptors[o.key]));
    }
  }
  return absl::OkStatus();
}

// Bundler writes no image sizes; where nothing tells an image's, the smallest
// that is symmetric about the centre and holds all measurements is taken.
void BundlerImporter::ChooseSizes() {
  Eigen::Vector2d half = Eigen::Vector2d::Ones();
  for (const BundlerObservation& o : model_.observations) {
    half = half.cwiseMax(o.xy_px.cast<double>().cwiseAbs());
  }
  constexpr double kMax = CameraModel::kMaxSizePx;
  const ImageSize bound{
      static_cast<int>(std::min(std::ceil(2.0 * half.x()), kMax)),
      static_cast<int>(std::min(std::ceil(2.0 * half.y()), kMax))};
  std::size_t num_assumed = 0;
  for (std::optional<ImageSize>& size : sizes_) {
    if (size) continue;
    size = bound;
    ++num_assumed;
  }
  if (num_assumed == 0) return;
  warnings_->push_back(absl::StrCat(
      "Bundler writes no image sizes and neither image nor .key file is there "
      "for ",
      num_assumed,
      " of ",
      sizes_.size(),
      " images; took ",
      bound.width_px,
      "x",
      bound.height_px,
      ", the extent of the measurements"));
}

absl::Status BundlerImporter::MakeCameras() {
  for (std::size_t v = 0; v < data_.views.size(); ++v) {
    const BundlerCamera& camera = model_.cameras[camera_of_[v]];
    const ImageSize& size = *sizes_[v];
    // The image's centre, with the first pixel's at (0.5, 0.5).
    const Eigen::Vector2d center_px(0.5 * size.width_px, 0.5 * size.height_px);
    auto model = CameraModel::Create(CameraModelId::kRadial,
                                     size.width_px,
                                     size.height_px,
                                     std::array{camera.focal_px,
                                                center_px.x(),
                                                center_px.y(),
                                                camera.k1,
                                                camera.k2});
    if (!model.ok()) {
      return base::Annotate(model.status(),
                            absl::StrCat("camera ", camera_of_[v]));
    }
    map::MapViewData& view = data_.views[v];
    view.camera = static_cast<std::uint32_t>(data_.cameras.size());
    data_.cameras.push_back(*std::move(model));
    for (const BundlerObservation& o : ObservationsOf(camera_of_[v])) {
      view.keypoints_px.emplace_back(o.xy_px + center_px.cast<float>());
      view.landmarks.push_back(o.point);
    }
  }
  return absl::OkStatus();
}

absl::Status BundlerImporter::Describe(std::vector<std::string>* lacking) {
  std::vector<ViewImage> images(data_.views.size());
  for (std::size_t v = 0; v < images.size(); ++v) {
    data_.views[v].descriptors.clear();
    if (images_[v]) images[v].path = *images_[v];
  }
  lacking->clear();
  return DescribeFromImages(images, go_on_, &data_, lacking, warnings_);
}

absl::StatusOr<map::MapData> BundlerImporter::Run(const std::string& source) {
  data_.source_format = "bundler";
  data_.landmarks = std::move(model_.points);
  SortObservations();
  RETURN_IF_ERROR(MakeViews());
  std::vector<std::string> lacking;
  RETURN_IF_ERROR(ReadKeyFiles(&lacking));
  ChooseSizes();
  RETURN_IF_ERROR(MakeCameras());
  const bool have_images =
      std::any_of(images_.begin(), images_.end(), [](const auto& i) {
        return i.has_value();
      });
  if (!lacking.empty() && have_images) RETURN_IF_ERROR(Describe(&lacking));
  SettleDescriptors(lacking,
                    absl::StrCat(source, " (.key files and images)"),
                    &data_,
                    warnings_);
  return std::move(data_);
}

// Bundler's script leaves bundle/bundle.out, and the list and the images above.
std::vector<fs::path> Folders(const fs::path& path, const fs::path& images) {
  if (!images.empty()) return {images, FolderOf(path)};
  return {FolderOf(path), FolderOf(path) / ".."};
}

absl::StatusOr<BundlerModel> ReadBundler(const fs::path& path,
                                         MemoryBudget& budget) {
  ASSIGN_OR_RETURN(const base::MappedFile text,
                   budget.Open(path, ModelFileKind::kTextOfFeatures));
  return ParseBundler(text.bytes(), path.string());
}

}  // namespace

absl::StatusOr<map::MapData> ImportBundler(const fs::path& path,
                                           const fs::path& images,
                                           MemoryBudget& budget,
                                           const std::function<bool()>& go_on,
                                           std::vector<std::string>* warnings) {
  ASSIGN_OR_RETURN(BundlerModel model, ReadBundler(path, budget));
  std::vector<fs::path> folders = Folders(path, images);
  ASSIGN_OR_RETURN(ImageList list,
                   FindList(folders, model.cameras.size(), budget));
  BundlerImporter importer(
      std::move(model), std::move(list), std::move(folders), go_on, warnings);
  auto data = importer.Run(path.string());
  if (!data.ok()) return base::Annotate(data.status(), path.string());
  return data;
}

absl::StatusOr<std::vector<ImportFile>> FindBundlerFiles(
    const fs::path& path, const fs::path& images) {
  MemoryBudget budget(0);
  ASSIGN_OR_RETURN(const BundlerModel model, ReadBundler(path, budget));
  const std::vector<fs::path> folders = Folders(path, images);
  ASSIGN_OR_RETURN(const ImageList list,
                   FindList(folders, model.cameras.size(), budget));
  std::vector<ImportFile> files;
  if (!list.file.empty())
    files.push_back({list.file, absl::StrCat(kImagesFolder, "/list.txt")});
  for (std::size_t i = 0; i < list.names.size(); ++i) {
    const std::string& name = list.names[i];
    // Without a list, the images of a folder are counted: all must be there.
    if (model.cameras[i].focal_px == 0.0 && !list.guessed) continue;
    if (auto image = FindNamedFile(folders, name)) {
      files.push_back({*image, RemoteName(name)});
    }
    if (auto keys = FindKeys(folders, name)) {
      const bool packed = keys->extension() == ".gz";
      files.push_back({*keys, RemoteName(name, packed ? ".key.gz" : ".key")});
    }
  }
  return files;
}

}  // namespace groundlock::formats::internal
