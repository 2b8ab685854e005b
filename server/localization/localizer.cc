// SPDX-License-Identifier: Apache-2.0
#include "server/localization/localizer.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/localization/baseline_localizer.h"
#include "server/localization/fast_localizer.h"

namespace groundlock::localization {
namespace {

constexpr std::string_view kBaseline = "baseline";
constexpr std::string_view kFast = "fast";

template <typename T>
absl::Status OutOfRange(std::string_view field,
                        const T& value,
                        std::string_view bound) {
  return absl::InvalidArgumentError(absl::StrCat("localizer option ",
                                                 base::Abseil(field),
                                                 " is ",
                                                 value,
                                                 ", must be ",
                                                 base::Abseil(bound)));
}

}  // namespace

absl::Status LocalizerOptions::Validate() const {
  // Comparisons are written so that NaN fails them.
  if (min_inliers < 4) {
    return OutOfRange("min_inliers", min_inliers, "at least 4");
  }
  if (!(ratio_test > 0.0 && ratio_test <= 1.0)) {
    return OutOfRange("ratio_test", ratio_test, "in (0, 1]");
  }
  if (!(max_error_px > 0.0 && max_error_px <= 100.0)) {
    return OutOfRange("max_error_px", max_error_px, "in (0, 100]");
  }
  if (!(ransac_confidence > 0.0 && ransac_confidence < 1.0)) {
    return OutOfRange("ransac_confidence", ransac_confidence, "in (0, 1)");
  }
  if (ransac_max_iterations < 1 || ransac_max_iterations > 1'000'000) {
    return OutOfRange(
        "ransac_max_iterations", ransac_max_iterations, "in [1, 1000000]");
  }
  if (min_landmark_views < 1) {
    return OutOfRange("min_landmark_views", min_landmark_views, "at least 1");
  }
  if (max_features < min_inliers || max_features > 100'000) {
    return OutOfRange("max_features", max_features, "in [min_inliers, 100000]");
  }
  if (!(sift_contrast_threshold >= 0.0 && sift_contrast_threshold < 1.0)) {
    return OutOfRange(
        "sift_contrast_threshold", sift_contrast_threshold, "in [0, 1)");
  }
  if (lost_after < std::chrono::nanoseconds{0}) {
    return OutOfRange("lost_after_ns", lost_after.count(), "at least 0");
  }
  if (imu) RETURN_IF_ERROR(base::Annotate(imu->Validate(), "imu"));
  return base::Annotate(fast.Validate(), "fast");
}

absl::Status FastLocalizerOptions::Validate() const {
  // Counts of landmarks and frames alike.
  constexpr int kMost = 100'000;
  const std::pair<std::string_view, int> counts[] = {
      {"max_followed_landmarks", max_followed_landmarks},
      {"healthy_inliers", healthy_inliers},
      {"full_inliers", full_inliers},
      {"max_frames_per_key_frame", max_frames_per_key_frame},
      {"max_key_frames_per_anchor", max_key_frames_per_anchor},
      {"anchor_delay_frames", anchor_delay_frames},
      {"min_frames_between_anchors", min_frames_between_anchors},
      {"hurried_anchor_factor", hurried_anchor_factor},
      {"max_own_landmarks", max_own_landmarks},
      {"frames_per_observation", frames_per_observation},
      {"frames_per_odometry_observation", frames_per_odometry_observation}};
  for (const auto& [field, count] : counts) {
    if (count < 1 || count > kMost) {
      return OutOfRange(field, count, "in [1, 100000]");
    }
  }
  if (anchor_period < std::chrono::nanoseconds{0} ||
      anchor_period > std::chrono::hours{24}) {
    return OutOfRange(
        "anchor_period_ns", anchor_period.count(), "between 0 and a day");
  }
  return absl::OkStatus();
}

absl::Status ValidateRequest(const LocalizationRequest& request) {
  if (request.frame == nullptr || request.frame->luma.empty() ||
      request.frame->luma.type() != CV_8UC1) {
    return absl::InvalidArgumentError(
        "localisation needs a frame with an 8-bit luma image");
  }
  const cv::Size size_px = request.frame->size_px();
  if (size_px.width != request.camera.width_px() ||
      size_px.height != request.camera.height_px()) {
    return absl::InvalidArgumentError(absl::StrCat("the frame is ",
                                                   size_px.width,
                                                   "x",
                                                   size_px.height,
                                                   ", its camera ",
                                                   request.camera.width_px(),
                                                   "x",
                                                   request.camera.height_px()));
  }
  for (std::size_t i = 0; i < request.masks_px.size(); ++i) {
    if (!request.masks_px[i].IsFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("mask ", i, " is not finite"));
    }
  }
  RETURN_IF_ERROR(
      base::Annotate(ValidateInertial(request.inertial), "inertial"));
  return request.prior ? base::Annotate(request.prior->Validate(), "prior")
                       : absl::OkStatus();
}

std::string Localizer::Save() const { return {}; }

absl::Status Localizer::Restore(std::string_view state) {
  if (state.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      "the camera's state is of another localizer");
}

absl::StatusOr<std::unique_ptr<Localizer>> CreateLocalizer(
    std::string_view name,
    std::shared_ptr<const map::Map> map,
    const LocalizerOptions& options,
    BackgroundRunner run_in_background) {
  RETURN_IF_ERROR(options.Validate());
  if (name != kBaseline && name != kFast) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown localizer '",
                     base::Abseil(name),
                     "'; known: ",
                     absl::StrJoin(LocalizerNames(), ", ")));
  }
  if (map == nullptr) {
    return absl::InvalidArgumentError("a localizer needs a map");
  }
  if (!map->info().has_descriptors) {
    return absl::FailedPreconditionError(
        "the map has no descriptors: import it with its database or features");
  }
  map->VerifyInBackground();
  if (name == kFast) {
    return std::make_unique<FastLocalizer>(
        std::move(map), options, std::move(run_in_background));
  }
  return std::make_unique<BaselineLocalizer>(std::move(map), options);
}

std::vector<std::string> LocalizerNames() {
  return {std::string(kFast), std::string(kBaseline)};
}

}  // namespace groundlock::localization
