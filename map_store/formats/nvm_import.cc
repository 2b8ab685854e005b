// SPDX-License-Identifier: Apache-2.0
// VisualSFM: .nvm, with .sift files and images beside it.
#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include "map_store/base/file.h"
#include "map_store/base/order_statistics.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/descriptors.h"
#include "map_store/formats/internal/image_size.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/named_files.h"
#include "map_store/formats/internal/nvm_model.h"

namespace groundlock::formats::internal {
namespace {

// Of one image: millions of features.
constexpr std::uint64_t kMaxSiftFileBytes = std::uint64_t{1} << 30;

namespace fs = std::filesystem;

// NVM measurements are .sift locations minus one offset per image; VisualSFM
// prints them to 1e-9, so anything beyond this is another file.
constexpr double kSiftTolerance_px = 0.1;
// Share of an image's measurements that must agree with its .sift file.
constexpr double kMinAgreeing = 0.9;
// Above this (a tenth of a keypoint's noise) a user hears of it.
constexpr double kInexactFit_px = 0.05;

// What is known of one image beyond the .nvm file.
struct ImageFacts {
  std::optional<ImageSize> size;                // from its header
  std::optional<Eigen::Vector2d> principal_px;  // from its .sift file
  Eigen::Vector2d max_sift_px = Eigen::Vector2d::Zero();
  bool has_descriptors = false;
};

// The offset from the view's measurements to its .sift locations, if they
// belong together.
std::optional<Eigen::Vector2d> PrincipalPointFromSift(
    std::span<const NvmMeasurement> measurements, const SiftFile& sift) {
  std::vector<double> dx;
  std::vector<double> dy;
  for (const NvmMeasurement& m : measurements) {
    if (m.feature >= sift.size()) return std::nullopt;
    const Eigen::Vector2d delta =
        (sift.KeypointPx(m.feature) - m.xy_px).cast<double>();
    if (!delta.allFinite()) return std::nullopt;
    dx.push_back(delta.x());
    dy.push_back(delta.y());
  }
  if (dx.empty()) return std::nullopt;
  // The float locations round to about 1e-4 px; a centre is a multiple of 0.5.
  Eigen::Vector2d offset(base::Median(std::move(dx)),
                         base::Median(std::move(dy)));
  const Eigen::Vector2d rounded = (2.0 * offset).array().round() / 2.0;
  if ((rounded - offset).cwiseAbs().maxCoeff() < 1e-3) offset = rounded;
  std::size_t num_agreeing = 0;
  for (const NvmMeasurement& m : measurements) {
    const Eigen::Vector2d delta =
        (sift.KeypointPx(m.feature) - m.xy_px).cast<double>() - offset;
    if (delta.norm() < kSiftTolerance_px) ++num_agreeing;
  }
  const double share = static_cast<double>(num_agreeing) /
                       static_cast<double>(measurements.size());
  if (share < kMinAgreeing) return std::nullopt;
  return offset;
}

// Reads one image's header and .sift file, and its descriptors into `view`.
absl::StatusOr<ImageFacts> ReadFacts(
    std::span<const fs::path> folders,
    const std::string& name,
    std::span<const NvmMeasurement> measurements,
    map::MapViewData* view) {
  ImageFacts facts;
  if (const auto image = FindNamedFile(folders, name)) {
    facts.size = ReadImageSize(*image);
  }
  const auto path = FindNamedFile(folders, name, ".sift");
  if (!path) return facts;
  ASSIGN_OR_RETURN(const base::MappedFile file,
                   base::MappedFile::Open(*path, kMaxSiftFileBytes));
  ASSIGN_OR_RETURN(const SiftFile sift,
                   SiftFile::Parse(file.bytes(), path->string()));
  facts.principal_px = PrincipalPointFromSift(measurements, sift);
  if (!facts.principal_px) return facts;
  for (std::size_t i = 0; i < sift.size(); ++i) {
    const Eigen::Vector2d xy = sift.KeypointPx(i).cast<double>();
    if (xy.allFinite()) facts.max_sift_px = facts.max_sift_px.cwiseMax(xy);
  }
  view->descriptors.reserve(measurements.size());
  for (const NvmMeasurement& m : measurements) {
    view->descriptors.push_back(RootSiftFromSift(sift.Descriptor(m.feature)));
  }
  facts.has_descriptors = true;
  return facts;
}

// The smallest size that is symmetric about the centre and holds everything.
ImageSize BoundingSize(std::span<const NvmMeasurement> measurements) {
  Eigen::Vector2d half = Eigen::Vector2d::Ones();
  for (const NvmMeasurement& m : measurements) {
    half = half.cwiseMax(m.xy_px.cast<double>().cwiseAbs());
  }
  constexpr double kMax = geometry::CameraModel::kMaxSizePx;
  return {static_cast<int>(std::min(std::ceil(2.0 * half.x()), kMax)),
          static_cast<int>(std::min(std::ceil(2.0 * half.y()), kMax))};
}

// One calibration: equal ones become one camera of the map.
using CameraKey = std::tuple<double, double, int, int, double, double>;

class Importer {
 public:
  Importer(NvmFile file,
           std::vector<fs::path> folders,
           std::vector<std::string>* warnings)
      : file_(std::move(file)),
        folders_(std::move(folders)),
        warnings_(warnings) {}

  absl::StatusOr<map::MapData> Run(const std::string& source);

 private:
  std::span<const NvmMeasurement> MeasurementsOf(std::size_t camera) const {
    return std::span(file_.model.measurements)
        .subspan(first_[camera], first_[camera + 1] - first_[camera]);
  }
  void SortMeasurements();
  absl::Status NameViews();
  absl::Status ReadImages(std::vector<std::string>* lacking);
  void ChooseSizes();
  absl::Status MakeCameras();
  absl::StatusOr<std::uint32_t> CameraOf(std::size_t view,
                                         const Eigen::Vector2d& principal_px);
  void WarnOfDistortion() const;

  NvmFile file_;
  std::vector<fs::path> folders_;
  std::vector<std::string>* warnings_;
  map::MapData data_;
  std::vector<std::size_t> first_;  // measurement of each camera, and the end
  std::vector<ImageFacts> facts_;
  std::vector<ImageSize> sizes_;
  std::map<CameraKey, std::uint32_t> camera_by_key_;
  std::size_t num_inexact_ = 0;
  std::size_t num_folding_ = 0;
  double max_residual_px_ = 0.0;
};

void Importer::SortMeasurements() {
  std::vector<NvmMeasurement>& all = file_.model.measurements;
  std::sort(all.begin(),
            all.end(),
            [](const NvmMeasurement& a, const NvmMeasurement& b) {
              return std::tie(a.camera, a.feature, a.point) <
                     std::tie(b.camera, b.feature, b.point);
            });
  first_.assign(file_.model.cameras.size() + 1, 0);
  for (const NvmMeasurement& m : all) ++first_[m.camera + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
}

// Views are named by the image's file name where that is unambiguous: paths of
// the machine that VisualSFM ran on mean nothing here.
absl::Status Importer::NameViews() {
  std::vector<std::string> full;
  full.reserve(file_.model.cameras.size());
  for (const NvmCamera& camera : file_.model.cameras) {
    full.push_back(camera.name);
  }
  ASSIGN_OR_RETURN(const std::vector<std::string> names, ViewNames(full));
  for (std::size_t i = 0; i < names.size(); ++i) data_.views[i].name = names[i];
  return absl::OkStatus();
}

absl::Status Importer::ReadImages(std::vector<std::string>* lacking) {
  for (std::size_t i = 0; i < data_.views.size(); ++i) {
    map::MapViewData& view = data_.views[i];
    view.camera_from_world = file_.model.cameras[i].camera_from_world;
    ASSIGN_OR_RETURN(
        facts_.emplace_back(),
        ReadFacts(
            folders_, file_.model.cameras[i].name, MeasurementsOf(i), &view));
    if (!facts_.back().has_descriptors && !MeasurementsOf(i).empty()) {
      lacking->push_back(view.name);
    }
  }
  return absl::OkStatus();
}

// NVM has no image sizes. In order: the image's header; twice the offset of its
// .sift file; what other images of the model say, if they agree and it fits;
// the extent of the measurements of all images.
void Importer::ChooseSizes() {
  std::vector<std::optional<ImageSize>> known(facts_.size());
  std::optional<ImageSize> common;
  bool agree = true;
  for (std::size_t i = 0; i < facts_.size(); ++i) {
    known[i] = facts_[i].size;
    if (!known[i] && facts_[i].principal_px) {
      const Eigen::Vector2d twice = (2.0 * *facts_[i].principal_px)
                                        .cwiseMax(facts_[i].max_sift_px)
                                        .cwiseMin(65'535.0)
                                        .cwiseMax(1.0);
      known[i] = ImageSize{static_cast<int>(std::lround(twice.x())),
                           static_cast<int>(std::lround(twice.y()))};
    }
    if (!known[i]) continue;
    agree = agree && (!common || *common == *known[i]);
    common = known[i];
  }
  const ImageSize bound = BoundingSize(file_.model.measurements);
  const bool fits = common && agree && bound.width_px <= common->width_px &&
                    bound.height_px <= common->height_px;
  const ImageSize assumed = fits ? *common : bound;
  std::size_t num_assumed = 0;
  for (const std::optional<ImageSize>& size : known) {
    sizes_.push_back(size.value_or(assumed));
    if (!size) ++num_assumed;
  }
  if (num_assumed == 0) return;
  warnings_->push_back(absl::StrCat(
      "NVM holds no image sizes and neither image nor .sift file is there for ",
      num_assumed,
      " of ",
      known.size(),
      " images; took ",
      assumed.width_px,
      "x",
      assumed.height_px,
      fits ? ", the size of the others" : ", the extent of the measurements"));
}

absl::StatusOr<std::uint32_t> Importer::CameraOf(
    std::size_t view, const Eigen::Vector2d& principal_px) {
  const NvmCamera& source = file_.model.cameras[view];
  const ImageSize& size = sizes_[view];
  const CameraKey key(source.focal_px,
                      source.r,
                      size.width_px,
                      size.height_px,
                      principal_px.x(),
                      principal_px.y());
  const auto [found, is_new] = camera_by_key_.try_emplace(
      key, static_cast<std::uint32_t>(data_.cameras.size()));
  if (!is_new) return found->second;
  const Eigen::Vector2d size_px(size.width_px, size.height_px);
  const double radius_px = principal_px.cwiseAbs()
                               .cwiseMax((size_px - principal_px).cwiseAbs())
                               .norm();
  auto fitted = CameraFromNvm(source.focal_px,
                              source.r,
                              size.width_px,
                              size.height_px,
                              principal_px,
                              radius_px);
  if (!fitted.ok()) {
    return base::Annotate(fitted.status(),
                          absl::StrCat("camera of image ", source.name));
  }
  if (fitted->max_residual_px > kInexactFit_px) ++num_inexact_;
  if (fitted->radius_px < radius_px) ++num_folding_;
  max_residual_px_ = std::max(max_residual_px_, fitted->max_residual_px);
  data_.cameras.push_back(fitted->camera);
  return found->second;
}

absl::Status Importer::MakeCameras() {
  for (std::size_t i = 0; i < data_.views.size(); ++i) {
    Eigen::Vector2d principal_px(0.5 * sizes_[i].width_px,
                                 0.5 * sizes_[i].height_px);
    if (facts_[i].principal_px) {
      principal_px = *facts_[i].principal_px;
    } else if (file_.calibration) {
      principal_px = {file_.calibration->cx_px, file_.calibration->cy_px};
    }
    map::MapViewData& view = data_.views[i];
    ASSIGN_OR_RETURN(view.camera, CameraOf(i, principal_px));
    const std::span<const NvmMeasurement> measurements = MeasurementsOf(i);
    view.keypoints_px.reserve(measurements.size());
    view.landmarks.reserve(measurements.size());
    for (const NvmMeasurement& m : measurements) {
      view.keypoints_px.emplace_back(m.xy_px + principal_px.cast<float>());
      view.landmarks.push_back(m.point);
    }
  }
  return absl::OkStatus();
}

void Importer::WarnOfDistortion() const {
  if (num_inexact_ > 0) {
    warnings_->push_back(
        absl::StrCat("the distortion of ",
                     num_inexact_,
                     " cameras could only be converted to within ",
                     max_residual_px_,
                     " px at the border"));
  }
  if (num_folding_ > 0) {
    warnings_->push_back(absl::StrCat(
        "the distortion of ",
        num_folding_,
        " cameras folds back inside the image; their corners are not usable"));
  }
  if (file_.calibration &&
      std::abs(file_.calibration->fy_px / file_.calibration->fx_px - 1.0) >
          1e-3) {
    warnings_->push_back(
        "FixedK gives two focal lengths; NVM's cameras have one, which was "
        "taken for both directions");
  }
}

absl::StatusOr<map::MapData> Importer::Run(const std::string& source) {
  data_.source_format = "nvm";
  data_.landmarks = std::move(file_.model.points);
  data_.views.resize(file_.model.cameras.size());
  SortMeasurements();
  RETURN_IF_ERROR(NameViews());
  std::vector<std::string> lacking;
  RETURN_IF_ERROR(ReadImages(&lacking));
  ChooseSizes();
  RETURN_IF_ERROR(MakeCameras());
  WarnOfDistortion();
  SettleDescriptors(
      lacking, absl::StrCat(source, " (.sift files)"), &data_, warnings_);
  return std::move(data_);
}

std::vector<fs::path> ImageFolders(const fs::path& path,
                                   const fs::path& images) {
  return {images.empty() ? FolderOf(path) : images};
}

absl::StatusOr<NvmFile> ReadNvm(const fs::path& path, MemoryBudget& budget) {
  ASSIGN_OR_RETURN(const base::MappedFile text,
                   budget.Open(path, ModelFileKind::kTextOfFeatures));
  return ParseNvm(text.bytes(), path.string());
}

}  // namespace

absl::StatusOr<map::MapData> ImportNvm(const fs::path& path,
                                       const fs::path& images,
                                       MemoryBudget& budget,
                                       std::vector<std::string>* warnings) {
  ASSIGN_OR_RETURN(NvmFile file, ReadNvm(path, budget));
  if (file.num_models > 1) {
    warnings->push_back(absl::StrCat(path.string(),
                                     " holds ",
                                     file.num_models,
                                     " models; took the largest, with ",
                                     file.model.cameras.size(),
                                     " images and ",
                                     file.model.points.size(),
                                     " points"));
  }
  Importer importer(std::move(file), ImageFolders(path, images), warnings);
  auto data = importer.Run(path.string());
  if (!data.ok()) return base::Annotate(data.status(), path.string());
  return data;
}

absl::StatusOr<std::vector<ImportFile>> FindNvmFiles(const fs::path& path,
                                                     const fs::path& images) {
  MemoryBudget budget(0);
  ASSIGN_OR_RETURN(const NvmFile file, ReadNvm(path, budget));
  std::vector<ImportFile> found;
  for (const NvmCamera& camera : file.model.cameras) {
    const auto folders = ImageFolders(path, images);
    if (auto sift = FindNamedFile(folders, camera.name, ".sift")) {
      found.push_back({*sift, RemoteName(camera.name, ".sift")});
    } else if (auto image = FindNamedFile(folders, camera.name)) {
      found.push_back({*image, RemoteName(camera.name)});
    }
  }
  return found;
}

}  // namespace groundlock::formats::internal
