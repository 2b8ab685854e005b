// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchoring.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "map_store/features/sift_features.h"
#include "server/localization/search/feature_errors.h"
#include "server/localization/search/guided_matching.h"
#include "server/localization/search/lens_check.h"
#include "server/localization/search/one_surface.h"
#include "server/localization/search/place_search.h"
#include "server/localization/solvers/agreement.h"

namespace groundlock::localization {
namespace {

// Radii of guided matching around a prior, tried in turn: a fresh prior is off
// by a few pixels, one from a fast turn by many.
constexpr double kPriorRadii_px[] = {12.0, 40.0};
// The same around a pose by other sensors: a compass is off by degrees.
constexpr double kSensorRadii_px[] = {40.0, 120.0};
// A pose found anew gathers its matches first, and is verified then.
constexpr double kFoundRadii_px[] = {16.0, 9.0};

// With fewer of the features that are wanted around a predicted pose, an image
// twice as large is looked at: what there is to see is far away.
constexpr double kFewFeatures = 0.5;

// Of the ground, over the mean distance of the landmarks that agree.
constexpr double kGroundOverDistance = 0.05;

// Without a prior.
constexpr int kFirstFeatures = 1'000;
constexpr int kPhotographFeatures = 2'500;
constexpr std::size_t kPromisingInliers = 20;

std::vector<PoseObservation> ToObservations(
    const map::Map& map, const std::vector<GuidedMatch>& matches) {
  std::vector<PoseObservation> observations;
  observations.reserve(matches.size());
  for (const GuidedMatch& match : matches) {
    observations.push_back(
        {map.landmarks()[match.landmark].Position(), match.pixel_px});
  }
  return observations;
}

// A pose, and what agrees with it.
struct Refined {
  Anchor anchor;
  std::vector<Likeness> agreeing;
};

std::size_t MostInliers(const std::vector<PlacePose>& places) {
  std::size_t most = 0;
  for (const PlacePose& place : places) {
    most = std::max(most, place.num_inliers);
  }
  return most;
}

// How a search ended.
struct Search {
  std::optional<Anchor> anchor;
  // A pose was no accident, but the frame's mirror image has one that is as
  // good: more features would not help.
  bool is_contradicted = false;
};

// One frame's search, by whatever features are given.
struct FrameSearch {
  const map::Map& map;
  const AnchorRequest& request;
  const AnchorOptions& options;

  // Guided matching and robust refinement with shrinking radii; nullopt if that
  // leads to no pose. Whether it is believed is another question.
  std::optional<Refined> Refine(const features::SiftFeatures& features,
                                const geometry::Rigid3& initial,
                                std::span<const double> radii_px) const {
    geometry::Rigid3 world_from_camera = initial;
    std::optional<Refined> refined;
    for (const double radius_px : radii_px) {
      const std::vector<GuidedMatch> matches =
          Match(features, world_from_camera, radius_px);
      RobustPoseOptions refinement;
      refinement.initial_gate_px = radius_px;
      refinement.final_gate_px = std::min(radius_px, kFeatureGate_px);
      const std::vector<PoseObservation> observations =
          ToObservations(map, matches);
      auto pose = RefinePoseRobustly(
          request.camera, observations, world_from_camera, refinement);
      if (!pose) return std::nullopt;
      world_from_camera = pose->world_from_camera;
      refined.emplace();
      for (std::size_t i = 0; i < matches.size(); ++i) {
        if (pose->is_inlier[i] == 0) continue;
        refined->anchor.inliers.push_back(matches[i]);
        refined->agreeing.push_back(
            {matches[i].pixel_px, matches[i].squared_distance});
      }
      refined->anchor.pose = *std::move(pose);
    }
    return refined;
  }

  // Around `prior`, with each of the radii first; nullopt if nothing there is
  // believed.
  std::optional<Anchor> AroundPrior(
      const features::SiftFeatures& features,
      const geometry::Rigid3& prior,
      std::span<const double> first_radii_px) const {
    for (const double radius_px : first_radii_px) {
      const double radii_px[] = {
          radius_px, kFoundRadii_px[0], kFoundRadii_px[1]};
      auto refined = Refine(features, prior, radii_px);
      if (!refined || !IsBelieved(LogFalseAlarms(*refined, {}))) continue;
      const features::SiftFeatures mirrored = Mirrored(features);
      auto decoy = Refine(mirrored, prior, radii_px);
      // That led nowhere is no news of how much agrees by chance.
      if (!decoy) {
        decoy = Refine(
            mirrored, refined->anchor.pose.world_from_camera, kFoundRadii_px);
      }
      std::vector<Likeness> of_decoy;
      if (decoy) of_decoy = Unmirrored(decoy->agreeing);
      const double log_false_alarms = LogFalseAlarms(*refined, of_decoy);
      if (IsBelieved(log_false_alarms)) {
        refined->anchor.used_prior = true;
        refined->anchor.log_false_alarms = log_false_alarms;
        return std::move(refined->anchor);
      }
    }
    return std::nullopt;
  }

  std::optional<Anchor> AroundPriors(
      const features::SiftFeatures& features) const {
    std::optional<Anchor> anchor;
    if (request.prior_world_from_camera) {
      anchor = AroundPrior(
          features, *request.prior_world_from_camera, kPriorRadii_px);
    }
    if (anchor || !request.prior) return anchor;
    if (const auto sensed = request.prior->world_from_camera()) {
      anchor = AroundPrior(features, *sensed, kSensorRadii_px);
    }
    return anchor;
  }

  // In which the frame may have been taken.
  std::vector<PlacePose> Places(const features::SiftFeatures& features) const {
    PlaceSearchOptions search;
    search.seed = request.seed;
    return FindPlaces(map,
                      features,
                      request.camera,
                      ViewsNearPrior(map, request.prior.value_or(PosePrior())),
                      search);
  }

  // The first of the places that is believed.
  Search RefinePlaces(const features::SiftFeatures& features,
                      const std::vector<PlacePose>& places) const {
    Search search;
    std::optional<std::vector<Likeness>> decoy;
    for (const PlacePose& place : places) {
      auto refined = Refine(features, place.world_from_camera, kFoundRadii_px);
      if (!refined || !IsBelieved(LogFalseAlarms(*refined, {})) ||
          IsBelowGround(refined->anchor)) {
        continue;
      }
      if (!decoy) decoy = Decoy(features);
      const double log_false_alarms = LogFalseAlarms(*refined, *decoy);
      if (IsBelieved(log_false_alarms)) {
        if (LogMargin(log_false_alarms) + LogLikelierBeside(refined->anchor) <
            0.0) {
          continue;
        }
        refined->anchor.log_false_alarms = log_false_alarms;
        search.anchor = std::move(refined->anchor);
        return search;
      }
      search.is_contradicted = true;
    }
    return search;
  }

  double LogFalseAlarms(const Refined& refined,
                        std::span<const Likeness> decoy) const {
    return LogFalseAlarmsOverDecoy(
        AgreementOverDecoy(refined.agreeing, decoy, request.camera));
  }

  // By more than the ground, which is no plane, may be off.
  bool IsBelowGround(const Anchor& anchor) const {
    if (map.info().ground_state == map::GroundState::kUnknown ||
        !map.ground_relief().empty()) {
      return false;
    }
    const Eigen::Vector3d& center_world =
        anchor.pose.world_from_camera.translation;
    double distance = 0.0;
    for (const LandmarkMatch& match : anchor.inliers) {
      distance +=
          (map.landmarks()[match.landmark].Position() - center_world).norm();
    }
    distance /= static_cast<double>(anchor.inliers.size());
    return map.info().ground_world.SignedDistance(center_world) <
           -kGroundOverDistance * distance;
  }

  double LogLikelierBeside(const Anchor& anchor) const {
    const auto seen = [&](std::span<const LandmarkMatch> matches) {
      std::vector<SeenPoint> points;
      points.reserve(matches.size());
      for (const LandmarkMatch& match : matches) {
        points.push_back(
            {map.landmarks()[match.landmark].Position(), match.pixel_px});
      }
      return points;
    };
    GuidedMatchingOptions in_view;
    in_view.min_landmark_views = options.min_landmark_views;
    const geometry::Rigid3& world_from_camera = anchor.pose.world_from_camera;
    return LogLikelierBesideSurface(
        seen(anchor.inliers),
        seen(LandmarksInView(map, request.camera, world_from_camera, in_view)),
        world_from_camera.translation,
        map.info().ground_state == map::GroundState::kUnknown
            ? std::nullopt
            : std::optional(map.info().ground_world.normal),
        request.camera,
        request.seed);
  }

  std::vector<LandmarkMatch> LensMatches(
      const features::SiftFeatures& features,
      const geometry::Rigid3& world_from_camera) const {
    const auto matches =
        Match(features, world_from_camera, kLensMatchRadius_px);
    return {matches.begin(), matches.end()};
  }

  // Where they match the landmarks that the pose projects near them.
  std::vector<GuidedMatch> Match(const features::SiftFeatures& features,
                                 const geometry::Rigid3& world_from_camera,
                                 double radius_px) const {
    GuidedMatchingOptions matching;
    matching.radius_px = radius_px;
    matching.min_landmark_views = options.min_landmark_views;
    return MatchGuided(
        map, features, request.camera, world_from_camera, matching);
  }

 private:
  features::SiftFeatures Mirrored(
      const features::SiftFeatures& features) const {
    return MirrorFeatures(features, request.camera.width_px());
  }

  // What agrees with the best pose of the frame's mirror image.
  std::vector<Likeness> Decoy(const features::SiftFeatures& features) const {
    const features::SiftFeatures mirrored = Mirrored(features);
    int most = 0;
    std::vector<Likeness> best;
    for (const PlacePose& place : Places(mirrored)) {
      auto decoy = Refine(mirrored, place.world_from_camera, kFoundRadii_px);
      if (!decoy) continue;
      const int places =
          AgreementOverDecoy(decoy->agreeing, {}, request.camera).places;
      if (places <= most) continue;
      most = places;
      best = Unmirrored(std::move(decoy->agreeing));
    }
    return best;
  }

  std::vector<Likeness> Unmirrored(std::vector<Likeness> mirrored) const {
    for (Likeness& match : mirrored) {
      match.pixel_px.x() = request.camera.width_px() - match.pixel_px.x();
    }
    return mirrored;
  }
};

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

std::optional<Anchor> FindNearPrior(const FrameSearch& search,
                                    features::SiftOptions sift) {
  const AnchorRequest& request = search.request;
  if (request.prior_world_from_camera) {
    sift.max_features = search.options.max_features_with_prior;
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
  auto anchor = search.AroundPriors(*features);
  if (anchor && request.wants_lens_matches) {
    anchor->lens_matches =
        search.LensMatches(*features, anchor->pose.world_from_camera);
  }
  return anchor;
}

std::optional<Anchor> FindAnywhere(const FrameSearch& search,
                                   features::SiftOptions sift) {
  const AnchorRequest& request = search.request;
  const AnchorOptions& options = search.options;
  const auto with_lens_matches = [&](Anchor anchor,
                                     const features::SiftFeatures& features) {
    if (request.wants_lens_matches) {
      anchor.lens_matches =
          search.LensMatches(features, anchor.pose.world_from_camera);
    }
    return anchor;
  };
  // The strongest features tell whether it is worth looking closer.
  sift.max_features = std::min(kFirstFeatures, options.max_features);
  const auto strongest =
      features::ExtractSift(request.luma, request.masks_px, sift);
  if (!strongest.ok()) return std::nullopt;
  std::vector<PlacePose> places = search.Places(*strongest);
  if (places.empty()) return std::nullopt;
  std::optional<features::SiftFeatures> fine;
  if (const auto fine_sift = FineSift(options, sift)) {
    auto features =
        features::ExtractSift(request.luma, request.masks_px, *fine_sift);
    if (!features.ok()) return std::nullopt;
    fine = *std::move(features);
  }
  // Where they are in the map, they mostly suffice.
  const features::SiftFeatures& first_features = fine ? *fine : *strongest;
  Search first = search.RefinePlaces(first_features, places);
  if (first.anchor) {
    return with_lens_matches(*std::move(first.anchor), first_features);
  }
  if (first.is_contradicted) return std::nullopt;
  // Then all, at half the size, and in full.
  sift.max_features = options.max_features;
  while (true) {
    const auto features =
        features::ExtractSift(request.luma, request.masks_px, sift);
    if (!features.ok()) return std::nullopt;
    Search closer = search.RefinePlaces(*features, places);
    if (!closer.anchor && !closer.is_contradicted) {
      places = search.Places(*features);
      closer = search.RefinePlaces(*features, places);
    }
    if (closer.anchor) {
      if (fine) {
        auto refined = search.Refine(
            *fine, closer.anchor->pose.world_from_camera, kFoundRadii_px);
        if (refined && IsBelieved(search.LogFalseAlarms(*refined, {}))) {
          return with_lens_matches(std::move(refined->anchor), *fine);
        }
      }
      return with_lens_matches(*std::move(closer.anchor), *features);
    }
    if (closer.is_contradicted || sift.halvings == 0 ||
        MostInliers(places) < kPromisingInliers) {
      return std::nullopt;
    }
    sift.halvings = 0;
  }
}

}  // namespace

std::optional<Anchor> FindAnchor(const map::Map& map,
                                 const AnchorRequest& request,
                                 const AnchorOptions& options) {
  const FrameSearch search{map, request, options};
  const features::SiftOptions usual = UsualSift(request, options);
  auto anchor = FindNearPrior(search, FineSift(options, usual).value_or(usual));
  if (anchor || !options.search_anywhere) return anchor;
  return FindAnywhere(search, usual);
}

}  // namespace groundlock::localization
