// SPDX-License-Identifier: Apache-2.0
// The thesis' camera localisation (Robinson 2014, §3.4), SIFT included: the
// yardstick for every faster localiser. Its cost grows with the map's views.
//
// One thing goes beyond the thesis: where motion blur or an empty sky leaves
// fewer than min_inliers in every view, a rough pose from one of them is
// completed by guided matching.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_

#include <Eigen/Core>
#include <compare>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "map_store/features/descriptor_matching.h"
#include "map_store/features/sift_features.h"
#include "map_store/map/map.h"
#include "server/localization/camera_state.h"
#include "server/localization/localizer.h"
#include "server/localization/solvers/pose_refinement.h"

namespace groundlock::localization {

// Indices of all views in the order in which they are tried: `last_view` first,
// then by distance from `center_world`; without it by falling number of
// features, the best guess there is. Ties by index.
std::vector<std::uint32_t> OrderViews(
    const map::Map& map,
    const std::optional<Eigen::Vector3d>& center_world,
    std::optional<std::uint32_t> last_view);

// A feature of the frame and the landmark that it looks like.
struct LandmarkCandidate {
  std::int32_t squared_distance = 0;  // of the descriptors
  std::uint32_t feature = 0;          // of the frame
  std::uint32_t landmark = 0;

  friend auto operator<=>(const LandmarkCandidate&,
                          const LandmarkCandidate&) = default;
};

// One candidate per landmark and per feature: closest descriptors first.
std::vector<LandmarkCandidate> MakeUnique(
    std::vector<LandmarkCandidate> candidates);

// 2D-3D correspondences between a frame and the map, as parallel arrays.
struct Correspondences {
  std::vector<std::uint32_t> landmarks;
  std::vector<Eigen::Vector3d> p_world;
  std::vector<Eigen::Vector2d> pixel_px;

  std::size_t size() const { return landmarks.size(); }
};

class BaselineLocalizer final : public Localizer {
 public:
  // map: with descriptors; options: valid (see CreateLocalizer).
  BaselineLocalizer(std::shared_ptr<const map::Map> map,
                    const LocalizerOptions& options);

  absl::StatusOr<LocalizationResult> Localize(
      const LocalizationRequest& request) override;
  void Reset() override;
  std::string Save() const override;
  absl::Status Restore(std::string_view state) override;

 private:
  struct Estimate {
    Correspondences correspondences;
    RefinedPose pose;
    std::vector<int> inliers;  // indices into correspondences
  };

  std::vector<LandmarkCandidate> MatchView(
      const map::MapView& view,
      const features::DescriptorSet& descriptors) const;
  Correspondences MakeCorrespondences(
      std::span<const LandmarkCandidate> candidates,
      const features::SiftFeatures& features) const;
  // nullopt if fewer than `min_inliers` agree on a pose.
  std::optional<Estimate> EstimatePose(const geometry::CameraModel& camera,
                                       Correspondences correspondences,
                                       std::size_t min_inliers,
                                       std::uint64_t seed,
                                       LocalizationReport& report) const;
  // Matches what lies near the projections of a rough pose.
  std::optional<Estimate> Complete(const geometry::CameraModel& camera,
                                   const features::SiftFeatures& features,
                                   const Estimate& rough,
                                   LocalizationReport& report) const;
  // Refines and chooses the inliers anew; false if the pose is not fixed or
  // fewer than `min_inliers` are left.
  bool Refine(const geometry::CameraModel& camera,
              double max_error_px,
              std::size_t min_inliers,
              Estimate& estimate) const;
  void Accept(const Estimate& estimate,
              std::chrono::nanoseconds time,
              LocalizationResult& result);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  CameraStateMachine state_;
  std::optional<std::uint32_t> last_view_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_
