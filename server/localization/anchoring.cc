// SPDX-License-Identifier: Apache-2.0
#include "server/localization/anchoring.h"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/map/landmark_index.h"
#include "server/localization/guided_matching.h"
#include "server/localization/pose_ransac.h"
#include "server/localization/sift_features.h"
#include "server/localization/view_coverage.h"

namespace groundlock::localization {
namespace {

constexpr int kGridColumns = 8;
constexpr int kGridRows = 6;

// Radii of guided matching around a prior, tried in turn: a fresh prior is off
// by a few pixels, one from a fast turn by many.
constexpr double kPriorRadii_px[] = {12.0, 40.0};
// The same around a pose by other sensors: a compass is off by degrees.
constexpr double kSensorRadii_px[] = {40.0, 120.0};
// A pose found anew gathers its matches first.
constexpr double kGatherRadius_px = 16.0;
// The last radius verifies: matches to the wrong landmarks spread evenly over
// it, so that a tenth of them falls within the gate by chance; of the right
// ones nearly all do.
constexpr double kVerifyRadius_px = 9.0;
constexpr double kMinVerifiedShare = 0.5;
// Inlier gate of a guided refinement; SIFT's own localisation error reaches a
// pixel and a half at coarse octaves.
constexpr double kGuidedGate_px = 3.0;

// Index search.
constexpr int kIndexLists = 12;
constexpr double kIndexRatio = 0.9;
constexpr int kMaxPlaces = 4;  // candidate places per frame
constexpr std::size_t kViewsPerPlace = 12;
constexpr double kIndexRansacGate_px = 6.0;
constexpr int kIndexRansacIterations = 600;
constexpr std::size_t kMinPlaceMatches = 12;
constexpr std::size_t kPromisingInliers = 20;

std::vector<PoseObservation> ToObservations(
    const map::Map& map, const std::vector<LandmarkMatch>& matches) {
  std::vector<PoseObservation> observations;
  observations.reserve(matches.size());
  for (const LandmarkMatch& match : matches) {
    observations.push_back(
        {map.landmarks()[match.landmark].Position(), match.pixel_px});
  }
  return observations;
}

// Guided matching and robust refinement with shrinking radii; nullopt unless
// the final pose is verified.
std::optional<Anchor> RefineAround(const map::Map& map,
                                   const AnchorRequest& request,
                                   const AnchorOptions& options,
                                   const SiftFeatures& features,
                                   const geometry::Rigid3& initial,
                                   std::span<const double> radii_px) {
  geometry::Rigid3 world_from_camera = initial;
  std::optional<Anchor> anchor;
  double share = 0.0;
  for (const double radius_px : radii_px) {
    GuidedMatchingOptions matching;
    matching.radius_px = radius_px;
    matching.min_landmark_views = options.min_landmark_views;
    const std::vector<LandmarkMatch> matches =
        MatchGuided(map, features, request.camera, world_from_camera, matching);
    RobustPoseOptions refinement;
    refinement.initial_gate_px = radius_px;
    refinement.final_gate_px = std::min(radius_px, kGuidedGate_px);
    const std::vector<PoseObservation> observations =
        ToObservations(map, matches);
    auto pose = RefinePoseRobustly(
        request.camera, observations, world_from_camera, refinement);
    if (!pose) return std::nullopt;
    world_from_camera = pose->world_from_camera;
    share = pose->num_inliers / static_cast<double>(matches.size());
    anchor.emplace();
    for (std::size_t i = 0; i < matches.size(); ++i) {
      if (pose->is_inlier[i] != 0) anchor->inliers.push_back(matches[i]);
    }
    anchor->pose = *std::move(pose);
  }
  if (!anchor || share < kMinVerifiedShare ||
      anchor->pose.num_inliers < options.min_inliers ||
      CountOccupiedCells(anchor->inliers, request.camera) < options.min_cells) {
    return std::nullopt;
  }
  return anchor;
}

//   first_radii_px  of guided matching around `prior`, tried in turn.
std::optional<Anchor> AnchorAroundPrior(
    const map::Map& map,
    const AnchorRequest& request,
    const AnchorOptions& options,
    const SiftFeatures& features,
    const geometry::Rigid3& prior,
    std::span<const double> first_radii_px) {
  for (const double radius_px : first_radii_px) {
    const double radii_px[] = {radius_px, kGatherRadius_px, kVerifyRadius_px};
    auto anchor =
        RefineAround(map, request, options, features, prior, radii_px);
    if (anchor) {
      anchor->used_prior = true;
      return anchor;
    }
  }
  return std::nullopt;
}

struct IndexedMatch {
  std::uint32_t landmark;
  std::uint32_t feature;
};

// Frame features that have one clearly nearest landmark in the whole map.
std::vector<IndexedMatch> MatchThroughIndex(const map::Map& map,
                                            const SiftFeatures& features) {
  std::vector<IndexedMatch> matches;
  for (std::uint32_t i = 0; i < features.descriptors.size(); ++i) {
    const map::IndexMatch match = map::FindLandmark(
        map.landmark_index(), features.descriptors[i], kIndexLists);
    if (match.landmark == map::IndexMatch::kNone) continue;
    if (match.squared_distance >
        kIndexRatio * kIndexRatio * match.second_squared_distance) {
      continue;
    }
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
    const std::vector<bool>& is_near) {
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
    if (places.size() >= kMaxPlaces || used.contains(seed_view)) continue;
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
    if (members.size() < kMinPlaceMatches) continue;
    std::vector<IndexedMatch> place;
    place.reserve(members.size());
    for (const std::size_t i : members) place.push_back(matches[i]);
    places.push_back(std::move(place));
  }
  return places;
}

// How a search through the index ended.
struct IndexSearch {
  std::optional<Anchor> anchor;
  // Some pose had more support than chance gives, though it was not verified.
  bool is_promising = false;
};

IndexSearch AnchorThroughIndex(const map::Map& map,
                               const AnchorRequest& request,
                               const AnchorOptions& options,
                               const SiftFeatures& features) {
  IndexSearch search;
  const std::vector<IndexedMatch> matches = MatchThroughIndex(map, features);
  std::uint64_t attempt = 0;
  for (const std::vector<IndexedMatch>& place :
       GroupByPlace(map,
                    matches,
                    ViewsNearPrior(map, request.prior.value_or(PosePrior())))) {
    std::vector<Eigen::Vector3d> p_world;
    std::vector<Eigen::Vector2d> pixel_px;
    for (const IndexedMatch& match : place) {
      p_world.push_back(map.landmarks()[match.landmark].Position());
      pixel_px.push_back(features.keypoints_px[match.feature]);
    }
    PoseRansacOptions ransac;
    ransac.max_error_px = kIndexRansacGate_px;
    ransac.max_iterations = kIndexRansacIterations;
    ransac.seed = base::MixSeed(request.seed, ++attempt);
    const auto report =
        EstimatePoseRansac(request.camera, p_world, pixel_px, ransac);
    if (!report.ok() || report->inliers.size() < kMinPlaceMatches) continue;
    search.is_promising |= report->inliers.size() >= kPromisingInliers;
    constexpr double kRadii_px[] = {kGatherRadius_px, kVerifyRadius_px};
    search.anchor = RefineAround(map,
                                 request,
                                 options,
                                 features,
                                 report->camera_from_world.Inverse(),
                                 kRadii_px);
    if (search.anchor &&
        ViewCoverage(map,
                     request.camera,
                     search.anchor->pose.world_from_camera,
                     request.masks_px,
                     search.anchor->inliers,
                     options.min_landmark_views) < options.min_coverage) {
      search.anchor.reset();
    }
    if (search.anchor) return search;
  }
  return search;
}

}  // namespace

int CountOccupiedCells(const std::vector<LandmarkMatch>& matches,
                       const geometry::CameraModel& camera) {
  std::bitset<kGridColumns * kGridRows> occupied;
  for (const LandmarkMatch& match : matches) {
    const int column =
        static_cast<int>(match.pixel_px.x() * kGridColumns / camera.width_px());
    const int row =
        static_cast<int>(match.pixel_px.y() * kGridRows / camera.height_px());
    if (column < 0 || row < 0 || column >= kGridColumns || row >= kGridRows) {
      continue;
    }
    occupied.set(row * kGridColumns + column);
  }
  return static_cast<int>(occupied.count());
}

std::optional<Anchor> FindAnchor(const map::Map& map,
                                 const AnchorRequest& request,
                                 const AnchorOptions& options) {
  SiftOptions sift;
  sift.max_features = request.prior_world_from_camera
                          ? options.max_features_with_prior
                          : options.max_features;
  sift.contrast_threshold = options.sift_contrast_threshold;
  const int longer_side_px = std::max(request.luma.cols, request.luma.rows);
  while (longer_side_px >> (sift.halvings + 1) >= options.min_longer_side_px) {
    ++sift.halvings;
  }
  const auto features = ExtractSift(request.luma, request.masks_px, sift);
  if (!features.ok()) return std::nullopt;
  if (request.prior_world_from_camera) {
    auto anchor = AnchorAroundPrior(map,
                                    request,
                                    options,
                                    *features,
                                    *request.prior_world_from_camera,
                                    kPriorRadii_px);
    if (anchor) return anchor;
  }
  const auto sensed =
      request.prior ? request.prior->world_from_camera() : std::nullopt;
  if (sensed) {
    auto anchor = AnchorAroundPrior(
        map, request, options, *features, *sensed, kSensorRadii_px);
    if (anchor) return anchor;
  }
  IndexSearch search = AnchorThroughIndex(map, request, options, *features);
  if (search.anchor || !search.is_promising || sift.halvings == 0) {
    return std::move(search.anchor);
  }
  // Something is there: what was halved away may decide it.
  sift.halvings = 0;
  sift.max_features = options.max_features;
  const auto all = ExtractSift(request.luma, request.masks_px, sift);
  if (!all.ok()) return std::nullopt;
  return AnchorThroughIndex(map, request, options, *all).anchor;
}

}  // namespace groundlock::localization
