// SPDX-License-Identifier: Apache-2.0
// The thesis' camera localisation (Robinson 2014, §3.4), SIFT included: the
// yardstick for every faster localiser. Its cost grows with the map's views.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "map_store/map/map.h"
#include "server/localization/camera_state.h"
#include "server/localization/descriptor_matching.h"
#include "server/localization/localizer.h"
#include "server/localization/pose_refinement.h"
#include "server/localization/sift_features.h"

namespace groundlock::localization {

// Indices of all views in the order in which they are tried: `last_view` first,
// then by distance from `center_world`; without it by falling number of
// features, the best guess there is. Ties by index.
std::vector<std::uint32_t> OrderViews(
    const map::Map& map,
    const std::optional<Eigen::Vector3d>& center_world,
    std::optional<std::uint32_t> last_view);

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

 private:
  struct VerifiedPose {
    RefinedPose pose;
    std::vector<int> inliers;  // indices into the correspondences
  };

  // One correspondence per landmark and per feature: the closest descriptors.
  Correspondences MatchView(const map::MapView& view,
                            const SiftFeatures& features,
                            const DescriptorSet& descriptors) const;
  // nullopt if fewer than min_inliers agree on a pose.
  std::optional<VerifiedPose> EstimatePose(
      const geometry::CameraModel& camera,
      const Correspondences& correspondences,
      std::uint64_t seed,
      LocalizationReport& report) const;
  void Accept(const VerifiedPose& verified,
              const Correspondences& correspondences,
              std::chrono::nanoseconds time,
              LocalizationResult& result);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  CameraStateMachine state_;
  std::optional<std::uint32_t> last_view_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_BASELINE_LOCALIZER_H_
