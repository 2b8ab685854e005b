// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/build/grow.h"
#include "map_store/build/internal/bundle_adjustment.h"
#include "map_store/build/internal/epipolar_matching.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/landmark_matching.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/map/landmark_index.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPairsPerImage = 10;
constexpr double kMinOverlap = 0.2;
constexpr double kMaxExtendedError_px = 4.0;
// With fewer landmarks, a map cannot be looked up in.
constexpr int kMinIndexViews = 2;

// A new image that found its place.
struct Placed {
  std::size_t image = 0;  // index into the new images
  internal::FoundPose pose;
};

class MapExtension {
 public:
  MapExtension(const ExtendOptions& options,
               const ProgressCallback& progress,
               map::MapData* data)
      : options_(options), progress_(progress), data_(*data) {}

  absl::StatusOr<ExtendReport> Run() {
    if (!data_.has_descriptors()) {
      return absl::FailedPreconditionError(
          "a map without descriptors cannot be extended: no image finds its "
          "place in it");
    }
    RETURN_IF_ERROR(FindFeatures());
    RETURN_IF_ERROR(Register());
    RETURN_IF_ERROR(TriangulateNew());
    RETURN_IF_ERROR(Adjust());
    return std::move(report_);
  }

 private:
  absl::Status FindFeatures();
  absl::StatusOr<std::uint32_t> CameraFor(
      const internal::ImageFeatures& features);
  absl::Status Register();
  absl::Status TriangulateNew();
  absl::Status Adjust();
  bool Progress(const char* stage, double fraction) const {
    return !progress_ || progress_({stage, fraction, ""});
  }
  std::function<bool(std::size_t)> CountProgress(const char* stage,
                                                 std::size_t total) const {
    return [this, stage, total](std::size_t done) {
      return Progress(
          stage,
          total == 0 ? 1.0
                     : static_cast<double>(done) / static_cast<double>(total));
    };
  }

  const ExtendOptions& options_;
  const ProgressCallback& progress_;
  map::MapData& data_;
  std::vector<internal::ImageFeatures> features_;
  std::vector<std::uint32_t> cameras_;  // of the new images, in data_
  std::vector<Placed> placed_;
  std::size_t num_old_views_ = 0;
  std::size_t num_old_landmarks_ = 0;
  ExtendReport report_;
};

absl::Status MapExtension::FindFeatures() {
  num_old_views_ = data_.views.size();
  num_old_landmarks_ = data_.landmarks.size();
  ASSIGN_OR_RETURN(const std::vector<fs::path> files,
                   internal::ListImages(options_.images));
  std::set<std::string> names;
  for (const map::MapViewData& view : data_.views) names.insert(view.name);
  for (const fs::path& file : files) {
    if (names.count(file.filename().string()) > 0) {
      return absl::AlreadyExistsError(
          absl::StrCat(file.filename().string(),
                       ": the map has an image of this name; rename the file "
                       "if it is another one"));
    }
  }
  internal::ImageFeatureOptions extraction;
  extraction.max_features = options_.max_features;
  extraction.threads = options_.threads;
  ASSIGN_OR_RETURN(
      features_,
      internal::ExtractFeatures(
          files, extraction, CountProgress("features", files.size())));
  for (const internal::ImageFeatures& image : features_) {
    ASSIGN_OR_RETURN(const std::uint32_t camera, CameraFor(image));
    cameras_.push_back(camera);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::uint32_t> MapExtension::CameraFor(
    const internal::ImageFeatures& features) {
  const auto fits = [&features](const geometry::CameraModel& camera) {
    return camera.width_px() == features.width_px &&
           camera.height_px() == features.height_px;
  };
  if (options_.camera) {
    if (!fits(*options_.camera)) {
      return absl::InvalidArgumentError(
          absl::StrCat(features.name,
                       ": ",
                       features.width_px,
                       "x",
                       features.height_px,
                       ", but the camera's images are ",
                       options_.camera->width_px(),
                       "x",
                       options_.camera->height_px()));
    }
    const auto known =
        std::find(data_.cameras.begin(), data_.cameras.end(), *options_.camera);
    if (known == data_.cameras.end()) {
      data_.cameras.push_back(*options_.camera);
      return static_cast<std::uint32_t>(data_.cameras.size() - 1);
    }
    return static_cast<std::uint32_t>(known - data_.cameras.begin());
  }
  const auto known =
      std::find_if(data_.cameras.begin(), data_.cameras.end(), fits);
  if (known == data_.cameras.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat(features.name,
                     ": the map has no camera of ",
                     features.width_px,
                     "x",
                     features.height_px,
                     "; give the lens with --camera"));
  }
  return static_cast<std::uint32_t>(known - data_.cameras.begin());
}

absl::Status MapExtension::Register() {
  const map::LandmarkIndexData index_data =
      map::BuildLandmarkIndex(data_, kMinIndexViews);
  const map::LandmarkIndex index = map::ViewOf(index_data);
  std::vector<std::optional<internal::FoundPose>> found(features_.size());
  RETURN_IF_ERROR(internal::ForEachInParallel(
      features_.size(),
      options_.threads,
      [&](std::size_t i) {
        found[i] = internal::FindPose(features_[i],
                                      data_.cameras[cameras_[i]],
                                      data_,
                                      index,
                                      options_.min_inliers);
        return absl::OkStatus();
      },
      CountProgress("registering", features_.size())));
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!found[i]) {
      report_.not_registered.push_back(features_[i].name);
      continue;
    }
    report_.registered.push_back(features_[i].name);
    placed_.push_back({i, *std::move(found[i])});
  }
  if (placed_.empty()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "none of ",
        features_.size(),
        " images found its place in the map: they must show some of what the "
        "map shows, from a similar side (and --camera must be their lens)"));
  }
  for (const Placed& placed : placed_) {
    const internal::ImageFeatures& features = features_[placed.image];
    map::MapViewData view;
    view.name = features.name;
    view.camera = cameras_[placed.image];
    view.camera_from_world = placed.pose.camera_from_world;
    for (const internal::LandmarkMatch& match : placed.pose.inliers) {
      view.keypoints_px.push_back(features.keypoints_px[match.query]);
      view.descriptors.push_back(features.descriptors[match.query]);
      view.landmarks.push_back(match.landmark);
    }
    report_.num_new_observations += placed.pose.inliers.size();
    data_.views.push_back(std::move(view));
  }
  // The poses first, from what was there; the new landmarks then lie well.
  return Adjust();
}

absl::Status MapExtension::TriangulateNew() {
  // A map of its own, whose views are the new ones, takes the new landmarks.
  map::MapData fresh;
  std::vector<internal::PosedFeatures> posed;
  std::vector<std::set<std::uint32_t>> used(placed_.size());
  for (std::size_t i = 0; i < placed_.size(); ++i) {
    const map::MapViewData& view = data_.views[num_old_views_ + i];
    posed.push_back({&features_[placed_[i].image],
                     &data_.cameras[view.camera],
                     view.camera_from_world});
    for (const internal::LandmarkMatch& match : placed_[i].pose.inliers) {
      used[i].insert(match.query);
    }
    fresh.views.emplace_back();
  }
  const std::vector<internal::ImagePair> pairs =
      internal::ChoosePairsByOverlap(posed, kPairsPerImage, kMinOverlap);
  std::vector<internal::PairMatches> matches(pairs.size());
  RETURN_IF_ERROR(internal::ForEachInParallel(
      pairs.size(),
      options_.threads,
      [&](std::size_t i) {
        matches[i].pair = pairs[i];
        matches[i].features = internal::MatchAlongEpipolarLines(
            posed[pairs[i].first], posed[pairs[i].second], {});
        std::erase_if(matches[i].features, [&](const auto& match) {
          return used[pairs[i].first].count(match[0]) > 0 ||
                 used[pairs[i].second].count(match[1]) > 0;
        });
        return absl::OkStatus();
      },
      CountProgress("triangulating", pairs.size())));
  report_.num_new_landmarks =
      internal::TriangulateTracks(posed, matches, {}, &fresh);
  for (std::size_t i = 0; i < fresh.views.size(); ++i) {
    map::MapViewData& view = data_.views[num_old_views_ + i];
    const map::MapViewData& added = fresh.views[i];
    for (std::size_t f = 0; f < added.landmarks.size(); ++f) {
      view.keypoints_px.push_back(added.keypoints_px[f]);
      view.descriptors.push_back(added.descriptors[f]);
      view.landmarks.push_back(added.landmarks[f] +
                               static_cast<std::uint32_t>(num_old_landmarks_));
    }
  }
  data_.landmarks.insert(
      data_.landmarks.end(), fresh.landmarks.begin(), fresh.landmarks.end());
  return absl::OkStatus();
}

absl::Status MapExtension::Adjust() {
  if (!Progress("adjusting", 0.0)) return absl::CancelledError("cancelled");
  std::vector<internal::PosePrior> priors(data_.views.size());
  for (std::size_t v = 0; v < num_old_views_; ++v) priors[v].is_fixed = true;
  internal::AdjustmentOptions adjustment;
  adjustment.threads = options_.threads;
  adjustment.landmark_is_fixed.resize(data_.landmarks.size());
  std::fill_n(adjustment.landmark_is_fixed.begin(), num_old_landmarks_, true);
  adjustment.is_cancelled = [this] { return !Progress("adjusting", 0.5); };
  RETURN_IF_ERROR(internal::AdjustMap(priors, adjustment, &data_));
  // Only at the end: filtering renumbers landmarks.
  if (report_.num_new_landmarks > 0 ||
      data_.landmarks.size() > num_old_landmarks_) {
    internal::FilterMap(2, kMaxExtendedError_px, &data_);
  }
  report_.mean_reprojection_error_px =
      map::ComputeReprojection(data_).mean_error_px;
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<ExtendReport> ExtendMap(const ExtendOptions& options,
                                       const ProgressCallback& progress,
                                       map::MapData* data) {
  return MapExtension(options, progress, data).Run();
}

}  // namespace groundlock::build
