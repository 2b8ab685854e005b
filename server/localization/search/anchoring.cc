// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchoring.h"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <utility>

#include "map_store/features/sift_features.h"
#include "server/localization/search/guided_matching.h"
#include "server/localization/search/lens_check.h"
#include "server/localization/search/place_search.h"
#include "server/localization/search/view_coverage.h"

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
constexpr double kFoundRadii_px[] = {kGatherRadius_px, kVerifyRadius_px};
constexpr double kMinVerifiedShare = 0.5;
// Inlier gate of a guided refinement; SIFT's own localisation error reaches a
// pixel and a half at coarse octaves.
constexpr double kGuidedGate_px = 3.0;

// With fewer of the features that are wanted around a predicted pose, an image
// twice as large is looked at: what there is to see is far away.
constexpr double kFewFeatures = 0.5;

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
                                   const features::SiftFeatures& features,
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
  if (request.wants_lens_matches) {
    GuidedMatchingOptions matching;
    matching.radius_px = kLensMatchRadius_px;
    matching.min_landmark_views = options.min_landmark_views;
    anchor->lens_matches =
        MatchGuided(map, features, request.camera, world_from_camera, matching);
  }
  return anchor;
}

//   first_radii_px  of guided matching around `prior`, tried in turn.
std::optional<Anchor> AnchorAroundPrior(
    const map::Map& map,
    const AnchorRequest& request,
    const AnchorOptions& options,
    const features::SiftFeatures& features,
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
                    const features::SiftFeatures& features,
                    const std::vector<PlacePose>& places) {
  Search search;
  for (const PlacePose& place : places) {
    search.anchor = RefineAround(map,
                                 request,
                                 options,
                                 features,
                                 place.world_from_camera,
                                 kFoundRadii_px);
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
                                       const features::SiftFeatures& features) {
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

// Of the frame halved while it stays large enough.
features::SiftOptions UsualSift(const AnchorRequest& request,
                                const AnchorOptions& options) {
  features::SiftOptions sift;
  sift.contrast_threshold = options.sift_contrast_threshold;
  sift.max_features = options.max_features;
  const int longer_side_px = std::max(request.luma.cols, request.luma.rows);
  while (longer_side_px >> (sift.halvings + 1) >= options.min_longer_side_px) {
    ++sift.halvings;
  }
  return sift;
}

// Of a photograph, if there is more to it than the usual size shows.
std::optional<features::SiftOptions> FineSift(const AnchorOptions& options,
                                              features::SiftOptions usual) {
  if (!options.is_photograph || usual.halvings == 0) return std::nullopt;
  --usual.halvings;
  usual.max_features = std::min(kPhotographFeatures, options.max_features);
  return usual;
}

std::optional<Anchor> AnchorAroundPriors(
    const map::Map& map,
    const AnchorRequest& request,
    const AnchorOptions& options,
    const features::SiftFeatures& features) {
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
                                    features::SiftOptions sift) {
  if (request.prior_world_from_camera) {
    sift.max_features = options.max_features_with_prior;
  } else if (!request.prior || !request.prior->world_from_camera()) {
    return std::nullopt;
  }
  auto features = features::ExtractSift(request.luma, request.masks_px, sift);
  if (request.prior_world_from_camera && features.ok() && sift.halvings > 0 &&
      static_cast<double>(features->keypoints_px.size()) <
          kFewFeatures * sift.max_features) {
    --sift.halvings;
    features = features::ExtractSift(request.luma, request.masks_px, sift);
  }
  if (!features.ok()) return std::nullopt;
  return AnchorAroundPriors(map, request, options, *features);
}

std::optional<Anchor> FindAnywhere(const map::Map& map,
                                   const AnchorRequest& request,
                                   const AnchorOptions& options,
                                   features::SiftOptions sift) {
  // The strongest features tell whether it is worth looking closer.
  sift.max_features = std::min(kFirstFeatures, options.max_features);
  const auto strongest =
      features::ExtractSift(request.luma, request.masks_px, sift);
  if (!strongest.ok()) return std::nullopt;
  std::vector<PlacePose> places = FindRightPlaces(map, request, *strongest);
  if (places.empty()) return std::nullopt;
  std::optional<features::SiftFeatures> fine;
  if (const auto fine_sift = FineSift(options, sift)) {
    auto features =
        features::ExtractSift(request.luma, request.masks_px, *fine_sift);
    if (!features.ok()) return std::nullopt;
    fine = *std::move(features);
  }
  // Where they are in the map, they mostly suffice.
  Search first =
      RefinePlaces(map, request, options, fine ? *fine : *strongest, places);
  if (first.anchor) return std::move(first.anchor);
  // Then all, at half the size, and in full.
  sift.max_features = options.max_features;
  while (true) {
    const auto features =
        features::ExtractSift(request.luma, request.masks_px, sift);
    if (!features.ok()) return std::nullopt;
    Search search = RefinePlaces(map, request, options, *features, places);
    if (!search.anchor && !search.is_contradicted) {
      places = FindRightPlaces(map, request, *features);
      search = RefinePlaces(map, request, options, *features, places);
    }
    if (search.anchor && fine) {
      auto refined = RefineAround(map,
                                  request,
                                  options,
                                  *fine,
                                  search.anchor->pose.world_from_camera,
                                  kFoundRadii_px);
      if (refined) return refined;
    }
    if (search.anchor || search.is_contradicted || sift.halvings == 0 ||
        MostInliers(places) < kPromisingInliers) {
      return std::move(search.anchor);
    }
    sift.halvings = 0;
  }
}

}  // namespace

int CountOccupiedCells(const std::vector<LandmarkMatch>& matches,
                       const geometry::CameraModel& camera) {
  std::bitset<kGridColumns * kGridRows> occupied;
  for (const LandmarkMatch& match : matches) {
    const double column = match.pixel_px.x() * kGridColumns / camera.width_px();
    const double row = match.pixel_px.y() * kGridRows / camera.height_px();
    if (!(column >= 0.0 && row >= 0.0 && column < kGridColumns &&
          row < kGridRows)) {
      continue;
    }
    occupied.set(static_cast<int>(row) * kGridColumns +
                 static_cast<int>(column));
  }
  return static_cast<int>(occupied.count());
}

std::optional<Anchor> FindAnchor(const map::Map& map,
                                 const AnchorRequest& request,
                                 const AnchorOptions& options) {
  const features::SiftOptions usual = UsualSift(request, options);
  auto anchor = FindNearPrior(
      map, request, options, FineSift(options, usual).value_or(usual));
  if (anchor || !options.search_anywhere) return anchor;
  return FindAnywhere(map, request, options, usual);
}

}  // namespace groundlock::localization
