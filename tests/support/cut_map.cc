// SPDX-License-Identifier: Apache-2.0
#include "tests/support/cut_map.h"

#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

namespace groundlock::test_support {

map::MapData CutMap(const map::MapData& whole, const geometry::Plane& plane) {
  constexpr auto kGone = std::numeric_limits<std::uint32_t>::max();
  map::MapData cut = whole;
  cut.landmarks.clear();
  cut.views.clear();
  std::vector<std::uint32_t> new_index(whole.landmarks.size(), kGone);
  for (std::size_t i = 0; i < whole.landmarks.size(); ++i) {
    if (plane.SignedDistance(whole.landmarks[i].p_world) > 0.0) continue;
    new_index[i] = static_cast<std::uint32_t>(cut.landmarks.size());
    cut.landmarks.push_back(whole.landmarks[i]);
  }
  for (const map::MapViewData& view : whole.views) {
    if (plane.SignedDistance(view.camera_from_world.Inverse().translation) >
        0.0) {
      continue;
    }
    map::MapViewData& kept = cut.views.emplace_back(view);
    kept.keypoints_px.clear();
    kept.landmarks.clear();
    kept.descriptors.clear();
    for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
      if (new_index[view.landmarks[i]] == kGone) continue;
      kept.keypoints_px.push_back(view.keypoints_px[i]);
      kept.landmarks.push_back(new_index[view.landmarks[i]]);
      if (!view.descriptors.empty()) {
        kept.descriptors.push_back(view.descriptors[i]);
      }
    }
  }
  return cut;
}

}  // namespace groundlock::test_support
