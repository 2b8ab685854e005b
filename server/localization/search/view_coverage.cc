// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/view_coverage.h"

#include <algorithm>
#include <array>
#include <unordered_set>

#include "server/localization/search/guided_matching.h"

namespace groundlock::localization {
namespace {

constexpr int kColumns = 8;
constexpr int kRows = 6;
constexpr int kMinExpected = 10;
constexpr double kFirmShare = 0.05;

using Counts = std::array<int, kColumns * kRows>;

void Count(const geometry::CameraModel& camera,
           const Eigen::Vector2d& pixel_px,
           Counts& counts) {
  const int column =
      std::clamp(static_cast<int>(pixel_px.x() * kColumns / camera.width_px()),
                 0,
                 kColumns - 1);
  const int row =
      std::clamp(static_cast<int>(pixel_px.y() * kRows / camera.height_px()),
                 0,
                 kRows - 1);
  ++counts[row * kColumns + column];
}

}  // namespace

double ViewCoverage(const map::Map& map,
                    const geometry::CameraModel& camera,
                    const geometry::Rigid3& world_from_camera,
                    const std::vector<geometry::Box2>& masks_px,
                    const std::vector<LandmarkMatch>& matches,
                    int min_landmark_views) {
  Counts expected{};
  Counts found{};
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::unordered_set<std::uint32_t> seen;
  const int max_views = GuidedMatchingOptions().max_views;
  for (const std::size_t index :
       NearbyViews(map, world_from_camera, max_views)) {
    for (const map::Feature& feature : map.FeaturesOf(map.view(index))) {
      const map::Landmark& landmark = map.landmarks()[feature.landmark];
      if (static_cast<int>(landmark.num_observations) < min_landmark_views ||
          !seen.insert(feature.landmark).second) {
        continue;
      }
      const auto pixel =
          camera.ImageFromCamera(camera_from_world * landmark.Position());
      if (!pixel || !camera.IsInsideImage(*pixel)) continue;
      const bool is_masked = std::any_of(
          masks_px.begin(), masks_px.end(), [&](const geometry::Box2& mask) {
            return mask.Contains(*pixel);
          });
      if (!is_masked) Count(camera, *pixel, expected);
    }
  }
  for (const LandmarkMatch& match : matches) {
    Count(camera, match.pixel_px, found);
  }
  double covered = 0.0;
  int cells = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    if (expected[i] < kMinExpected) continue;
    ++cells;
    if (found[i] > 0) covered += 0.5;
    if (found[i] > 0 && found[i] >= kFirmShare * expected[i]) covered += 0.5;
  }
  return cells > 0 ? covered / cells : 0.0;
}

}  // namespace groundlock::localization
