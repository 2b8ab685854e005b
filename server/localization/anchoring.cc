// SPDX-License-Identifier: Apache-2.0
#include "server/localization/anchoring.h"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <utility>

#include "server/localization/guided_matching.h"
#include "server/localization/place_search.h"
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

// Without a prior.
constexpr int kFirstFeatures = 1'000;
constexpr int kPhotographFeatures = 2'500;
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

// How a search ended.
struct Search {
  std::optional<Anchor> anchor;
  // A pose had the matches of an anchor, but what else is in view spoke against
  // it: more features would not help.
  bool is_contradicted = false;
};

Search RefinePlaces(const map::Map& map,
                    const AnchorRequest& request,
                    const AnchorOptions& options,
                    const SiftFeatures& features,
                    const std::vector<PlacePose>& places) {
  constexpr double kRadii_px[] = {kGatherRadius_px, kVerifyRadius_px};
  Search search;
  for (const PlacePose& place : places) {
    search.anchor = RefineAround(
        map, request, options, features, place.world_from_camera, kRadii_px);
    if (!search.anchor) continue;
    if (ViewCoverage(map,
                     request.camera,
                     search.anchor->pose.world_from_camera,
                     request.masks_px,
                     search.anchor->inliers,
                     options.min_landmark_views) >= options.min_coverage) {
      return search;
    }
    search.anchor.reset();
    search.is_contradicted = true;
  }
  return search;
}

std::size_t MostInliers(const std::vector<PlacePose>& places) {
  std::size_t most = 0;
  for (const PlacePose& place : places) {
    most = std::max(most, place.num_inliers);
  }
  return most;
}

// The places in which a frame may have been taken, by `features`; none if it
// was seen in a mirror.
std::vector<PlacePose> FindRightPlaces(const map::Map& map,
                                       const AnchorRequest& request,
                                       const SiftFeatures& features) {
  const std::vector<bool> is_near =
      ViewsNearPrior(map, request.prior.value_or(PosePrior()));
  PlaceSearchOptions search;
  search.seed = request.seed;
  std::vector<PlacePose> places =
      FindPlaces(map, features, request.camera, is_near, search);
  if (places.empty()) return places;
  search.max_places = 1;
  search.min_inliers = MostInliers(places) + 1;
  const auto mirrored =
      FindPlaces(map,
                 MirrorFeatures(features, request.camera.width_px()),
                 request.camera,
                 is_near,
                 search);
  if (!mirrored.empty()) places.clear();
  return places;
}

// Features by which a frame is looked at: first those of the first kind, then,
// if these do not suffice, of the next.
std::vector<SiftOptions> Looks(const AnchorRequest& request,
                               const AnchorOptions& options) {
  // Halved while it stays large enough.
  SiftOptions usual;
  usual.contrast_threshold = options.sift_contrast_threshold;
  usual.max_features = options.max_features;
  const int longer_side_px = std::max(request.luma.cols, request.luma.rows);
  while (longer_side_px >> (usual.halvings + 1) >= options.min_longer_side_px) {
    ++usual.halvings;
  }
  std::vector<SiftOptions> looks;
  if (options.is_photograph && usual.halvings > 0) {
    SiftOptions fine = usual;
    --fine.halvings;
    fine.max_features = std::min(kPhotographFeatures, options.max_features);
    looks.push_back(fine);
  }
  looks.push_back(usual);
  if (looks.back().halvings > 0) {
    SiftOptions full = usual;
    full.halvings = 0;
    looks.push_back(full);
  }
  return looks;
}

std::optional<Anchor> AnchorAroundPriors(const map::Map& map,
                                         const AnchorRequest& request,
                                         const AnchorOptions& options,
                                         const SiftFeatures& features) {
  std::optional<Anchor> anchor;
  if (request.prior_world_from_camera) {
    anchor = AnchorAroundPrior(map,
                               request,
                               options,
                               features,
                               *request.prior_world_from_camera,
                               kPriorRadii_px);
  }
  if (anchor || !request.prior) return anchor;
  if (const auto sensed = request.prior->world_from_camera()) {
    anchor = AnchorAroundPrior(
        map, request, options, features, *sensed, kSensorRadii_px);
  }
  return anchor;
}

std::optional<Anchor> FindNearPrior(const map::Map& map,
                                    const AnchorRequest& request,
                                    const AnchorOptions& options,
                                    SiftOptions sift) {
  if (request.prior_world_from_camera) {
    sift.max_features = options.max_features_with_prior;
  } else if (!request.prior || !request.prior->world_from_camera()) {
    return std::nullopt;
  }
  const auto features = ExtractSift(request.luma, request.masks_px, sift);
  if (!features.ok()) return std::nullopt;
  return AnchorAroundPriors(map, request, options, *features);
}

std::optional<Anchor> FindAnywhere(const map::Map& map,
                                   const AnchorRequest& request,
                                   const AnchorOptions& options,
                                   std::span<const SiftOptions> looks) {
  // The strongest features, of the usual size, tell whether it is worth looking
  // closer.
  SiftOptions first = looks[options.is_photograph && looks.size() > 1 ? 1 : 0];
  first.max_features = std::min(kFirstFeatures, options.max_features);
  const auto strongest = ExtractSift(request.luma, request.masks_px, first);
  if (!strongest.ok()) return std::nullopt;
  std::vector<PlacePose> places = FindRightPlaces(map, request, *strongest);
  if (places.empty()) return std::nullopt;
  for (const SiftOptions& look : looks) {
    const auto features = ExtractSift(request.luma, request.masks_px, look);
    if (!features.ok()) return std::nullopt;
    Search search = RefinePlaces(map, request, options, *features, places);
    if (!search.anchor && !search.is_contradicted) {
      places = FindRightPlaces(map, request, *features);
      search = RefinePlaces(map, request, options, *features, places);
    }
    if (search.anchor || search.is_contradicted) return search.anchor;
    if (look.halvings == first.halvings &&
        MostInliers(places) < kPromisingInliers) {
      break;
    }
  }
  return std::nullopt;
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
  const std::vector<SiftOptions> looks = Looks(request, options);
  auto anchor = FindNearPrior(map, request, options, looks.front());
  if (anchor) return anchor;
  return FindAnywhere(map, request, options, looks);
}

}  // namespace groundlock::localization
