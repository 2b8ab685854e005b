// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/map_filter.h"

#include <algorithm>
#include <limits>
#include <map>
#include <unordered_set>
#include <utility>

namespace groundlock::build::internal {
namespace {

constexpr std::uint32_t kGone = std::numeric_limits<std::uint32_t>::max();

// Keeps the features for which keep(index) holds.
template <typename Keep>
void KeepFeatures(const Keep& keep, map::MapViewData* view) {
  const bool has_descriptors = !view->descriptors.empty();
  std::size_t kept = 0;
  for (std::size_t i = 0; i < view->landmarks.size(); ++i) {
    if (!keep(i)) continue;
    view->landmarks[kept] = view->landmarks[i];
    view->keypoints_px[kept] = view->keypoints_px[i];
    if (has_descriptors) view->descriptors[kept] = view->descriptors[i];
    ++kept;
  }
  view->landmarks.resize(kept);
  view->keypoints_px.resize(kept);
  if (has_descriptors) view->descriptors.resize(kept);
}

}  // namespace

void KeepLandmarks(const std::vector<bool>& is_kept, map::MapData* data) {
  std::vector<std::uint32_t> renumbered(is_kept.size(), kGone);
  std::uint32_t count = 0;
  for (std::size_t i = 0; i < is_kept.size(); ++i) {
    if (!is_kept[i]) continue;
    data->landmarks[count] = data->landmarks[i];
    renumbered[i] = count++;
  }
  data->landmarks.resize(count);
  for (map::MapViewData& view : data->views) {
    KeepFeatures(
        [&](std::size_t i) { return renumbered[view.landmarks[i]] != kGone; },
        &view);
    for (std::uint32_t& landmark : view.landmarks) {
      landmark = renumbered[landmark];
    }
  }
}

std::vector<int> CountViews(const map::MapData& data) {
  std::vector<int> counts(data.landmarks.size());
  std::vector<std::size_t> last_view(data.landmarks.size(),
                                     std::numeric_limits<std::size_t>::max());
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    for (const std::uint32_t landmark : data.views[v].landmarks) {
      if (std::exchange(last_view[landmark], v) != v) ++counts[landmark];
    }
  }
  return counts;
}

void FilterMap(int min_views, double max_error_px, map::MapData* data) {
  for (map::MapViewData& view : data->views) {
    const geometry::CameraModel& camera = data->cameras[view.camera];
    std::unordered_set<std::uint32_t> seen;
    KeepFeatures(
        [&](std::size_t i) {
          const std::uint32_t landmark = view.landmarks[i];
          const auto pixel = camera.ImageFromCamera(
              view.camera_from_world * data->landmarks[landmark].p_world);
          return pixel &&
                 (*pixel - view.keypoints_px[i].cast<double>()).norm() <=
                     max_error_px &&
                 seen.insert(landmark).second;
        },
        &view);
  }
  const std::vector<int> counts = CountViews(*data);
  std::vector<bool> is_kept(counts.size());
  for (std::size_t i = 0; i < counts.size(); ++i) {
    is_kept[i] = counts[i] >= min_views;
  }
  KeepLandmarks(is_kept, data);
}

std::vector<std::string> DropMisplacedViews(std::span<const VerifiedPair> pairs,
                                            map::MapData* data) {
  // Of a view: its best partners, how many of their inliers must be common
  // landmarks, and how many inliers make a partner at all.
  constexpr std::size_t kPartners = 3;
  constexpr double kMinCommonShare = 0.1;
  constexpr int kMinInliers = 60;
  std::map<std::string, std::size_t> index;
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    index[data->views[v].name] = v;
  }
  std::vector<std::unordered_set<std::uint32_t>> seen(data->views.size());
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    const auto& landmarks = data->views[v].landmarks;
    seen[v].insert(landmarks.begin(), landmarks.end());
  }
  struct Partner {
    int num_inliers = 0;
    std::size_t view = 0;
  };
  std::vector<std::vector<Partner>> partners(data->views.size());
  for (const VerifiedPair& pair : pairs) {
    const auto first = index.find(pair.first);
    const auto second = index.find(pair.second);
    if (first == index.end() || second == index.end() ||
        pair.num_inliers < kMinInliers) {
      continue;
    }
    partners[first->second].push_back({pair.num_inliers, second->second});
    partners[second->second].push_back({pair.num_inliers, first->second});
  }
  std::vector<std::string> dropped;
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    std::stable_sort(partners[v].begin(),
                     partners[v].end(),
                     [](const Partner& a, const Partner& b) {
                       return a.num_inliers > b.num_inliers;
                     });
    partners[v].resize(std::min(kPartners, partners[v].size()));
    double inliers = 0.0;
    double common = 0.0;
    for (const Partner& partner : partners[v]) {
      inliers += partner.num_inliers;
      for (const std::uint32_t landmark : seen[v]) {
        common += seen[partner.view].count(landmark) > 0 ? 1.0 : 0.0;
      }
    }
    // A neighbour of a misplaced view still has its other partners.
    if (inliers > 0.0 && common < kMinCommonShare * inliers) {
      dropped.push_back(data->views[v].name);
    }
  }
  std::erase_if(data->views, [&dropped](const map::MapViewData& view) {
    return std::find(dropped.begin(), dropped.end(), view.name) !=
           dropped.end();
  });
  return dropped;
}

void DropEmptyViews(std::size_t min_observations, map::MapData* data) {
  std::erase_if(data->views, [&](const map::MapViewData& view) {
    return view.landmarks.size() < min_observations;
  });
  std::vector<std::uint32_t> renumbered(data->cameras.size(), kGone);
  std::vector<geometry::CameraModel> cameras;
  for (map::MapViewData& view : data->views) {
    std::uint32_t& camera = renumbered[view.camera];
    if (camera == kGone) {
      camera = static_cast<std::uint32_t>(cameras.size());
      cameras.push_back(data->cameras[view.camera]);
    }
    view.camera = camera;
  }
  data->cameras = std::move(cameras);
}

}  // namespace groundlock::build::internal
