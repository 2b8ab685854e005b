// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/posed.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/bundle_adjustment.h"
#include "map_store/build/internal/epipolar_matching.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/build/internal/triangulation.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPairsPerImage = 12;
constexpr double kMinOverlap = 0.15;
// What features themselves are off by; poses add to it.
constexpr double kFeatureGate_px = 3.0;
constexpr double kMaxPosedError_px = 3.0;
constexpr std::size_t kMinPosedObservations = 10;
constexpr std::size_t kMinLandmarks = 50;

class PosedBuild {
 public:
  PosedBuild(const PosedOptions& options, const ProgressCallback& progress)
      : options_(options), progress_(progress) {}

  absl::StatusOr<PosedResult> Run() {
    RETURN_IF_ERROR(FindImages());
    RETURN_IF_ERROR(Timed("features", [this] { return FindFeatures(); }));
    RETURN_IF_ERROR(Timed("matching", [this] { return Match(); }));
    RETURN_IF_ERROR(
        Timed("triangulating", [this] { return TriangulateAll(); }));
    RETURN_IF_ERROR(Timed("adjusting", [this] { return Adjust(); }));
    internal::DropEmptyViews(kMinPosedObservations, &result_.data);
    DescribeMap(result_.data, 0, &result_.report);
    for (std::string& weakness : FindWeaknesses(result_.data, result_.report)) {
      result_.report.warnings.push_back(std::move(weakness));
    }
    return std::move(result_);
  }

 private:
  absl::Status Timed(const char* stage,
                     const std::function<absl::Status()>& work) {
    stage_ = stage;
    const auto start = std::chrono::steady_clock::now();
    if (!Progress(0.0)) return absl::CancelledError("cancelled");
    RETURN_IF_ERROR(work());
    if (!Progress(1.0)) return absl::CancelledError("cancelled");
    StageReport report{.name = stage};
    report.wall_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
    result_.report.stages.push_back(report);
    return absl::OkStatus();
  }
  bool Progress(double fraction) const {
    return !progress_ || progress_({stage_, fraction, ""});
  }
  std::function<bool(std::size_t)> CountProgress(std::size_t total) const {
    return [this, total](std::size_t done) {
      return Progress(total == 0 ? 1.0
                                 : static_cast<double>(done) /
                                       static_cast<double>(total));
    };
  }

  absl::Status FindImages();
  absl::Status FindFeatures();
  absl::Status Match();
  absl::Status TriangulateAll();
  absl::Status Adjust();
  std::vector<internal::PosedFeatures> Posed() const;
  // How far an epipolar line may be off because of the poses.
  double PoseGate_px() const;

  const PosedOptions& options_;
  const ProgressCallback& progress_;
  const char* stage_ = "";
  std::vector<fs::path> files_;
  std::vector<PosedImage> poses_;  // of files_
  std::vector<internal::ImageFeatures> features_;
  std::vector<internal::PairMatches> matches_;
  PosedResult result_;
};

absl::Status PosedBuild::FindImages() {
  std::map<std::string, const PosedImage*> by_name;
  for (const PosedImage& pose : options_.poses) {
    if (!by_name.emplace(pose.name, &pose).second) {
      return absl::InvalidArgumentError(
          absl::StrCat("image ", pose.name, " has two poses"));
    }
  }
  ASSIGN_OR_RETURN(const std::vector<fs::path> files,
                   internal::ListImages(options_.images));
  std::size_t without = 0;
  for (const fs::path& file : files) {
    const auto it = by_name.find(file.filename().string());
    if (it == by_name.end()) {
      ++without;
      continue;
    }
    files_.push_back(file);
    poses_.push_back(*it->second);
  }
  if (files_.size() < 2) {
    return absl::InvalidArgumentError(
        absl::StrCat(options_.images.string(),
                     ": ",
                     files_.size(),
                     " of ",
                     files.size(),
                     " images have a pose; two are needed"));
  }
  if (without > 0) {
    result_.report.warnings.push_back(
        absl::StrCat(without, " images have no pose and were left out"));
  }
  return absl::OkStatus();
}

absl::Status PosedBuild::FindFeatures() {
  internal::ImageFeatureOptions extraction;
  extraction.max_features = options_.max_features;
  extraction.threads = options_.threads;
  ASSIGN_OR_RETURN(features_,
                   internal::ExtractFeatures(
                       files_, extraction, CountProgress(files_.size())));
  map::MapData& data = result_.data;
  data.source_format = "posed images";
  for (std::size_t i = 0; i < files_.size(); ++i) {
    const std::optional<geometry::CameraModel>& camera =
        poses_[i].camera ? poses_[i].camera : options_.camera;
    if (!camera) {
      return absl::InvalidArgumentError(absl::StrCat(
          "image ",
          features_[i].name,
          ": its lens is not known; give it with the poses, or one for all"));
    }
    if (camera->width_px() != features_[i].width_px ||
        camera->height_px() != features_[i].height_px) {
      return absl::InvalidArgumentError(
          absl::StrCat("image ",
                       features_[i].name,
                       ": ",
                       features_[i].width_px,
                       "x",
                       features_[i].height_px,
                       ", but its camera's images are ",
                       camera->width_px(),
                       "x",
                       camera->height_px()));
    }
    auto known = std::find(data.cameras.begin(), data.cameras.end(), *camera);
    const auto index = static_cast<std::uint32_t>(known - data.cameras.begin());
    if (known == data.cameras.end()) data.cameras.push_back(*camera);
    map::MapViewData view;
    view.name = features_[i].name;
    view.camera = index;
    view.camera_from_world = poses_[i].world_from_camera.Inverse();
    data.views.push_back(std::move(view));
    ImageReport image;
    image.name = features_[i].name;
    image.num_features = static_cast<int>(features_[i].keypoints_px.size());
    image.sharpness = features_[i].sharpness;
    result_.report.images.push_back(std::move(image));
  }
  return absl::OkStatus();
}

std::vector<internal::PosedFeatures> PosedBuild::Posed() const {
  std::vector<internal::PosedFeatures> posed;
  for (std::size_t i = 0; i < features_.size(); ++i) {
    const map::MapViewData& view = result_.data.views[i];
    posed.push_back({&features_[i],
                     &result_.data.cameras[view.camera],
                     view.camera_from_world});
  }
  return posed;
}

double PosedBuild::PoseGate_px() const {
  const std::vector<internal::PosedFeatures> posed = Posed();
  double focal = 0.0;
  double baseline = 0.0;
  for (const internal::PosedFeatures& image : posed) {
    focal = std::max(focal, image.camera->mean_focal_px());
  }
  for (std::size_t i = 0; i + 1 < posed.size(); ++i) {
    baseline += (posed[i].camera_from_world.Inverse().translation -
                 posed[i + 1].camera_from_world.Inverse().translation)
                    .norm();
  }
  baseline /= static_cast<double>(std::max<std::size_t>(1, posed.size() - 1));
  // Two sigma of two turned cameras; a shifted one tilts its lines by its share
  // of the baseline, over the parallax that is looked for (a tenth of a
  // radian).
  const double turned = options_.sigma_rad;
  const double shifted =
      baseline > 0.0 ? 0.1 * options_.sigma_m / baseline : 0.0;
  return 2.0 * std::sqrt(2.0) * focal * std::hypot(turned, shifted);
}

absl::Status PosedBuild::Match() {
  const std::vector<internal::PosedFeatures> posed = Posed();
  const std::vector<internal::ImagePair> pairs =
      internal::ChoosePairsByOverlap(posed, kPairsPerImage, kMinOverlap);
  internal::EpipolarOptions matching;
  matching.max_distance_px = kFeatureGate_px + PoseGate_px();
  matches_.resize(pairs.size());
  return internal::ForEachInParallel(
      pairs.size(),
      options_.threads,
      [&](std::size_t i) {
        matches_[i].pair = pairs[i];
        matches_[i].features = internal::MatchAlongEpipolarLines(
            posed[pairs[i].first], posed[pairs[i].second], matching);
        return absl::OkStatus();
      },
      CountProgress(pairs.size()));
}

absl::Status PosedBuild::TriangulateAll() {
  internal::TriangulationOptions triangulation;
  triangulation.max_error_px = kMaxPosedError_px + PoseGate_px();
  internal::TriangulateTracks(Posed(), matches_, triangulation, &result_.data);
  if (result_.data.landmarks.size() < kMinLandmarks) {
    return absl::FailedPreconditionError(absl::StrCat(
        "only ",
        result_.data.landmarks.size(),
        " landmarks came of ",
        features_.size(),
        " images: the poses do not fit the images. Poses are world_from_camera "
        "with x right, y down, z forward; if they are not exact, say how far "
        "they may be off (--pose-sigma)"));
  }
  return absl::OkStatus();
}

absl::Status PosedBuild::Adjust() {
  internal::PosePrior prior;
  prior.is_fixed = options_.sigma_m <= 0.0 && options_.sigma_rad <= 0.0;
  prior.sigma_m = options_.sigma_m;
  prior.sigma_rad = options_.sigma_rad;
  const std::vector<internal::PosePrior> priors(result_.data.views.size(),
                                                prior);
  internal::AdjustmentOptions adjustment;
  adjustment.threads = options_.threads;
  adjustment.is_cancelled = [this] { return !Progress(0.5); };
  RETURN_IF_ERROR(internal::AdjustMap(priors, adjustment, &result_.data));
  internal::FilterMap(options_.min_views, kMaxPosedError_px, &result_.data);
  return internal::AdjustMap(priors, adjustment, &result_.data);
}

}  // namespace

absl::Status PosedOptions::Validate() const {
  if (images.empty()) return absl::InvalidArgumentError("images: empty");
  if (poses.empty()) return absl::InvalidArgumentError("poses: empty");
  if (!(sigma_m >= 0.0) || !(sigma_rad >= 0.0) || !std::isfinite(sigma_m) ||
      !std::isfinite(sigma_rad)) {
    return absl::InvalidArgumentError(
        "sigma_m, sigma_rad: must be finite and not negative");
  }
  if (max_features < 100 || min_views < 2 || threads < 0) {
    return absl::InvalidArgumentError(
        "max_features below 100, min_views below 2 or threads below 0");
  }
  return absl::OkStatus();
}

absl::StatusOr<PosedResult> BuildFromPoses(const PosedOptions& options,
                                           const ProgressCallback& progress) {
  RETURN_IF_ERROR(options.Validate());
  return PosedBuild(options, progress).Run();
}

}  // namespace groundlock::build
