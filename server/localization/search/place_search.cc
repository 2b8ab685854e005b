// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/place_search.h"

#include <algorithm>
#include <cstddef>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/geometry/pose_ransac.h"
#include "map_store/map/landmark_index.h"

namespace groundlock::localization {
namespace {

constexpr int kIndexLists = 12;
constexpr double kIndexRatio = 0.9;
constexpr std::size_t kViewsPerPlace = 12;
constexpr double kRansacGate_px = 6.0;
constexpr int kRansacIterations = 600;

// A SIFT descriptor: 4 x 4 cells of 8 directions; its columns lie along the
// feature's direction, from which the cells' directions are counted.
constexpr std::size_t kCellRows = 4;
constexpr std::size_t kCellColumns = 4;
constexpr std::size_t kDirections = 8;

struct IndexedMatch {
  std::uint32_t landmark;
  std::uint32_t feature;
};

// Frame features that have one clearly nearest landmark in the whole map.
std::vector<IndexedMatch> MatchThroughIndex(
    const map::Map& map, const features::SiftFeatures& features) {
  std::vector<IndexedMatch> matches;
  for (std::uint32_t i = 0; i < features.descriptors.size(); ++i) {
    const map::IndexMatch match = map::FindLandmark(
        map.landmark_index(), features.descriptors[i], kIndexLists);
    if (match.landmark == map::IndexMatch::kNone) continue;
    if (match.squared_distance >
        kIndexRatio * kIndexRatio * match.second_squared_distance) {
      continue;
    }
    // Unlike those of a view, landmarks of the index have not been looked at.
    if (!map.landmarks()[match.landmark].Position().allFinite()) continue;
    matches.push_back({match.landmark, i});
  }
  return matches;
}

// Sets of matches whose landmarks were seen together: the views with most
// matches, each with the views that share landmarks with it. Those around views
// that are near come first.
// Source of the idea: Sattler, Leibe & Kobbelt 2012 (co-visibility).
std::vector<std::vector<IndexedMatch>> GroupByPlace(
    const map::Map& map,
    const std::vector<IndexedMatch>& matches,
    const std::vector<bool>& is_near,
    const PlaceSearchOptions& options) {
  std::unordered_map<std::uint32_t, std::vector<std::size_t>> matches_of_view;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    for (const std::uint64_t observation :
         map.ObservationsOf(map.landmarks()[matches[i].landmark])) {
      matches_of_view[map.features()[observation].view].push_back(i);
    }
  }
  std::vector<std::pair<std::size_t, std::uint32_t>> ranked;
  ranked.reserve(matches_of_view.size());
  for (const auto& [view, members] : matches_of_view) {
    ranked.emplace_back(members.size(), view);
  }
  std::sort(ranked.begin(), ranked.end(), [&](const auto& a, const auto& b) {
    if (is_near[a.second] != is_near[b.second]) return bool{is_near[a.second]};
    return a.first != b.first ? a.first > b.first : a.second < b.second;
  });

  std::vector<std::vector<IndexedMatch>> places;
  std::unordered_set<std::uint32_t> used;
  for (const auto& [count, seed_view] : ranked) {
    if (places.size() >= options.max_places || used.contains(seed_view))
      continue;
    // Views by the number of matches they share with the seed view.
    std::unordered_map<std::uint32_t, std::size_t> shared;
    for (const std::size_t i : matches_of_view[seed_view]) {
      for (const std::uint64_t observation :
           map.ObservationsOf(map.landmarks()[matches[i].landmark])) {
        ++shared[map.features()[observation].view];
      }
    }
    std::vector<std::pair<std::size_t, std::uint32_t>> partners;
    partners.reserve(shared.size());
    for (const auto& [view, n] : shared) partners.emplace_back(n, view);
    std::sort(
        partners.begin(), partners.end(), [](const auto& a, const auto& b) {
          return a.first != b.first ? a.first > b.first : a.second < b.second;
        });
    partners.resize(std::min(partners.size(), kViewsPerPlace));
    std::vector<std::size_t> members;
    for (const auto& [n, view] : partners) {
      used.insert(view);
      members.insert(members.end(),
                     matches_of_view[view].begin(),
                     matches_of_view[view].end());
    }
    std::sort(members.begin(), members.end());
    members.erase(std::unique(members.begin(), members.end()), members.end());
    if (members.size() < options.min_inliers) continue;
    std::vector<IndexedMatch> place;
    place.reserve(members.size());
    for (const std::size_t i : members) place.push_back(matches[i]);
    places.push_back(std::move(place));
  }
  return places;
}

}  // namespace

std::vector<PlacePose> FindPlaces(const map::Map& map,
                                  const features::SiftFeatures& features,
                                  const geometry::CameraModel& camera,
                                  const std::vector<bool>& is_near,
                                  const PlaceSearchOptions& options) {
  std::vector<PlacePose> poses;
  std::uint64_t attempt = 0;
  for (const std::vector<IndexedMatch>& place :
       GroupByPlace(map, MatchThroughIndex(map, features), is_near, options)) {
    std::vector<Eigen::Vector3d> p_world;
    std::vector<Eigen::Vector2d> pixel_px;
    for (const IndexedMatch& match : place) {
      p_world.push_back(map.landmarks()[match.landmark].Position());
      pixel_px.push_back(features.keypoints_px[match.feature]);
    }
    geometry::PoseRansacOptions ransac;
    ransac.max_error_px = kRansacGate_px;
    ransac.max_iterations = kRansacIterations;
    ransac.seed = base::MixSeed(options.seed, ++attempt);
    const auto report =
        geometry::EstimatePoseRansac(camera, p_world, pixel_px, ransac);
    if (!report.ok() || report->inliers.size() < options.min_inliers) continue;
    poses.push_back(
        {report->camera_from_world.Inverse(), report->inliers.size()});
  }
  return poses;
}

features::SiftFeatures MirrorFeatures(const features::SiftFeatures& features,
                                      double width_px) {
  features::SiftFeatures mirrored = features;
  for (Eigen::Vector2d& keypoint_px : mirrored.keypoints_px) {
    keypoint_px.x() = width_px - keypoint_px.x();
  }
  for (std::size_t i = 0; i < features.descriptors.size(); ++i) {
    const map::Descriptor& from = features.descriptors[i];
    map::Descriptor& to = mirrored.descriptors[i];
    for (std::size_t row = 0; row < kCellRows; ++row) {
      for (std::size_t column = 0; column < kCellColumns; ++column) {
        for (std::size_t direction = 0; direction < kDirections; ++direction) {
          to[((kCellRows - 1 - row) * kCellColumns + column) * kDirections +
             (kDirections - direction) % kDirections] =
              from[(row * kCellColumns + column) * kDirections + direction];
        }
      }
    }
  }
  return mirrored;
}

}  // namespace groundlock::localization
