// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/given_lens.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"

namespace groundlock::build::internal {
namespace {

// Another zoom or another mode of a camera changes its focal length by more,
// another copy of the same camera by less.
constexpr double kOtherLens = 0.05;
// Whoever gave the lens knows more of it than anybody else.
constexpr double kSigmas = 4.0;

// As a pinhole of the same mean focal length, with its principal point in the
// middle, would have shown them.
FeatureTracks WithoutDistortion(const FeatureTracks& tracks,
                                const geometry::CameraModel& camera) {
  const Eigen::Vector2d middle_px(0.5 * tracks.width_px,
                                  0.5 * tracks.height_px);
  FeatureTracks straight = tracks;
  for (FeatureTrack& track : straight.tracks) {
    FeatureTrack kept;
    for (const TrackSight& sight : track) {
      const auto xy = camera.NormalizedFromImage(sight.pixel_px.cast<double>());
      if (!xy) continue;
      kept.push_back(
          {sight.image,
           (middle_px + camera.mean_focal_px() * *xy).cast<float>()});
    }
    track = std::move(kept);
  }
  std::erase_if(straight.tracks,
                [](const FeatureTrack& track) { return track.size() < 2; });
  return straight;
}

bool IsAnother(double given_px, const TrackMotion& found) {
  const double focal_px = found.scene.lens.focal_px;
  return std::abs(std::log(focal_px / given_px)) >
         std::max(kOtherLens, kSigmas * *found.focal_sigma_px / focal_px);
}

bool ExplainsMore(const TrackScene& scene, const TrackScene& than) {
  return scene.CountPosed() >= than.CountPosed() &&
         scene.TrimmedCost_px2() < than.TrimmedCost_px2();
}

}  // namespace

std::string OtherLens::ToText() const {
  return absl::StrFormat(
      "the lens that was given does not fit what was filmed: its focal length "
      "is %.0f px, and what was filmed asks for %.0f +- %.0f px. A map is "
      "bent to fit the lens that it is built with; without --camera the lens "
      "is found along with it",
      given_focal_px,
      focal_px,
      focal_sigma_px);
}

absl::StatusOr<std::optional<OtherLens>> FindOtherLens(
    const FeatureTracks& tracks,
    const TrackScene* given_scene,
    const MotionOptions& options) {
  const double given_px = options.camera->mean_focal_px();
  MotionOptions freed = options;
  freed.camera.reset();
  std::optional<TrackMotion> best;
  for (const bool has_distortion : {false, true}) {
    auto found = ReconstructMotion(
        has_distortion ? tracks : WithoutDistortion(tracks, *options.camera),
        freed);
    if (absl::IsCancelled(found.status())) return found.status();
    if (!found.ok()) continue;  // nothing tells
    if (!IsAnother(given_px, *found)) return std::optional<OtherLens>();
    // The distortion of a wrong focal length is another distortion: one or the
    // other explains the tracks.
    if (!best || ExplainsMore(found->scene, best->scene)) {
      best = *std::move(found);
    }
  }
  if (!best) return std::optional<OtherLens>();
  // A start that went wrong is surer of itself than it should be, but what it
  // leads to explains less.
  if (given_scene != nullptr && !ExplainsMore(best->scene, *given_scene)) {
    return std::optional<OtherLens>();
  }
  return OtherLens{given_px, best->scene.lens.focal_px, *best->focal_sigma_px};
}

}  // namespace groundlock::build::internal
