// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/fresh_landmarks.h"

#include <algorithm>
#include <unordered_set>

#include "server/localization/search/guided_matching.h"

namespace groundlock::localization {
namespace {

// A similar place.
constexpr double kMinCosAngle = 0.94;  // 20 degrees
constexpr double kMaxDistanceRatio = 1.5;
constexpr int kViews = 6;
constexpr double kBorder_px = 8.0;

}  // namespace

std::vector<FollowedLandmark> ProjectFreshLandmarks(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    std::span<const geometry::Box2> masks_px,
    std::span<const FollowedLandmark> known,
    int min_landmark_views,
    int max_landmarks) {
  std::unordered_set<std::uint32_t> seen;
  for (const FollowedLandmark& landmark : known) {
    seen.insert(landmark.match.landmark);
  }
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<FollowedLandmark> fresh;
  for (const std::size_t index : NearbyViews(map, world_from_camera, kViews)) {
    const map::MapView& view = map.view(index);
    for (const map::Feature& feature : map.FeaturesOf(view)) {
      const map::Landmark& landmark = map.landmarks()[feature.landmark];
      if (static_cast<int>(landmark.num_observations) < min_landmark_views ||
          !seen.insert(feature.landmark).second) {
        continue;
      }
      const Eigen::Vector3d from_camera =
          landmark.Position() - world_from_camera.translation;
      const Eigen::Vector3d from_view = landmark.Position() - view.center_world;
      const double ratio = from_camera.norm() / from_view.norm();
      const double cos_angle =
          from_camera.dot(from_view) / (from_camera.norm() * from_view.norm());
      if (cos_angle < kMinCosAngle || ratio > kMaxDistanceRatio ||
          ratio < 1.0 / kMaxDistanceRatio) {
        continue;
      }
      const auto pixel =
          camera.ImageFromCamera(camera_from_world * landmark.Position());
      if (!pixel || !camera.IsInsideImage(*pixel, kBorder_px) ||
          std::any_of(masks_px.begin(), masks_px.end(), [&](const auto& mask) {
            return mask.Contains(*pixel);
          })) {
        continue;
      }
      fresh.push_back({{feature.landmark, *pixel}, /*is_anchored=*/false});
    }
  }
  return SpreadOverImage(map,
                         fresh,
                         {camera.width_px(), camera.height_px()},
                         std::max(0, max_landmarks));
}

}  // namespace groundlock::localization
