// SPDX-License-Identifier: Apache-2.0
// How FastLocalizer goes on where the map ends: by landmarks of the session's
// own.
#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <utility>
#include <vector>

#include "server/localization/fast_localizer.h"
#include "server/localization/follow/ground_depth.h"

namespace groundlock::localization {
namespace {

// Of a patch followed from a key frame.
constexpr double kFollow_px = 0.2;
// A landmark whose depth leaves its place in the image open by more says little
// of where the camera is.
constexpr double kMaxParallax_px = 1.0;
// Of an inverse depth, over itself, of what is somewhere in the scene.
constexpr double kUnknownDepth = 1.0;
// Of all depths at a time, by the poses from which they were triangulated: what
// odometry is off by grows with the way, and not with its square root.
constexpr double kScaleSigma = 0.005;

}  // namespace

KeyFrame FastLocalizer::WithOwnLandmarks(
    const MovingCamera& predicted, const geometry::CameraModel& camera) const {
  KeyFrame all = known_.key_frame;
  const geometry::Rigid3 key_from_world =
      known_.key_frame.world_from_camera.Inverse();
  const geometry::Rigid3 camera_from_world =
      predicted.world_from_camera.Inverse();
  for (const LandmarkMatch& match : known_.key_frame.own) {
    if (!known_.own.Has(match.landmark)) continue;
    const auto variance_px2 = known_.own.ParallaxVariance_px2(
        camera, key_from_world, camera_from_world, match.landmark);
    if (!variance_px2 || *variance_px2 > kMaxParallax_px * kMaxParallax_px) {
      continue;
    }
    all.landmarks.push_back({match, /*is_anchored=*/false});
  }
  // The first ones tell where the others are: they are to be spread.
  all.landmarks = SpreadOverImage(table(),
                                  all.landmarks,
                                  all.pyramid->size_px,
                                  static_cast<int>(all.landmarks.size()));
  return all;
}

std::vector<PoseObservation> FastLocalizer::Observations(
    const std::vector<FollowedLandmark>& seen,
    const MovingCamera& predicted,
    const geometry::CameraModel& camera) const {
  const geometry::Rigid3 key_from_world =
      known_.key_frame.world_from_camera.Inverse();
  const geometry::Rigid3 camera_from_world =
      predicted.world_from_camera.Inverse();
  std::unordered_map<std::uint32_t, Eigen::Vector2d> in_key;
  for (const LandmarkMatch& match : known_.key_frame.own) {
    in_key.emplace(match.landmark, match.pixel_px);
  }
  std::vector<PoseObservation> observations;
  observations.reserve(seen.size());
  for (const FollowedLandmark& landmark : seen) {
    const std::uint32_t id = landmark.match.landmark;
    PoseObservation observation{
        table().Position(id), landmark.match.pixel_px, 1.0};
    if (known_.own.Owns(id)) {
      const auto projected =
          camera.ImageFromCamera(key_from_world * observation.p_world);
      const auto found = in_key.find(id);
      const auto variance_px2 = known_.own.ParallaxVariance_px2(
          camera, key_from_world, camera_from_world, id);
      if (projected && variance_px2 && found != in_key.end()) {
        observation.pixel_px -= found->second - *projected;
        observation.weight =
            kFollow_px * kFollow_px / (kFollow_px * kFollow_px + *variance_px2);
      } else {
        observation.weight = 0.0;
      }
    }
    observations.push_back(observation);
  }
  return observations;
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowOdometry(
    const LocalizationRequest& request) {
  if (known_.key_frame.pyramid == nullptr || known_.key_frame.own.empty() ||
      known_.key_frame.pyramid->size_px != request.frame->size_px()) {
    return std::nullopt;
  }
  return FollowFrom(PredictedCamera(), request, Support::kMapAndOwn);
}

std::vector<LandmarkMatch> FastLocalizer::ObserveOwn(
    const LocalizationRequest& request) {
  std::erase_if(known_.key_frame.own, [&](const LandmarkMatch& match) {
    return !known_.own.Has(match.landmark);
  });
  if (known_.key_frame.own.empty() ||
      known_.key_frame.pyramid->size_px != request.frame->size_px()) {
    return {};
  }
  KeyFrame key = known_.key_frame;
  key.landmarks.clear();
  for (const LandmarkMatch& match : known_.key_frame.own) {
    key.landmarks.push_back({match, /*is_anchored=*/false});
  }
  const MovingCamera camera = PredictedCamera();
  std::vector<LandmarkMatch> seen;
  for (const FollowedLandmark& landmark :
       FollowLandmarks(table(),
                       key,
                       *request.frame->Pyramid(),
                       request.camera,
                       camera,
                       Reach::kUncertain)) {
    const bool is_masked =
        std::any_of(request.masks_px.begin(),
                    request.masks_px.end(),
                    [&](const geometry::Box2& mask) {
                      return mask.Contains(landmark.match.pixel_px);
                    });
    if (!is_masked) seen.push_back(landmark.match);
  }
  known_.own.Observe(request.camera, camera.world_from_camera, seen);
  std::erase_if(seen, [&](const LandmarkMatch& match) {
    return !known_.own.Has(match.landmark);
  });
  return seen;
}

void FastLocalizer::SetOwnLandmarks(const geometry::CameraModel& camera,
                                    std::span<const geometry::Box2> masks_px,
                                    std::vector<LandmarkMatch> carried) {
  std::erase_if(carried, [&](const LandmarkMatch& match) {
    return !known_.own.Has(match.landmark);
  });
  known_.own.Keep(carried);
  std::vector<LandmarkMatch> known = carried;
  std::vector<double> depths;
  const geometry::Rigid3 camera_from_world =
      known_.key_frame.world_from_camera.Inverse();
  for (const FollowedLandmark& landmark : known_.key_frame.landmarks) {
    known.push_back(landmark.match);
  }
  for (const LandmarkMatch& match : known) {
    depths.push_back(
        (camera_from_world * table().Position(match.landmark)).z());
  }
  if (depths.empty()) return;
  const auto middle =
      depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  const std::vector<Eigen::Vector2d> corners_px = FindFreeCorners_px(
      *known_.key_frame.pyramid,
      masks_px,
      known,
      options_.fast.max_own_landmarks - static_cast<int>(carried.size()));
  std::vector<SessionLandmarks::Sighting> sightings;
  sightings.reserve(corners_px.size());
  for (const Eigen::Vector2d& corner_px : corners_px) {
    SessionLandmarks::Sighting sighting{corner_px, *middle, kUnknownDepth};
    const auto ground = DepthOfGround(
        *map_, camera, known_.key_frame.world_from_camera, corner_px);
    if (ground) {
      sighting.depth = ground->depth;
      sighting.relative_sigma = ground->relative_sigma;
    }
    sightings.push_back(sighting);
  }
  const std::vector<LandmarkMatch> added =
      known_.own.Add(camera, known_.key_frame.world_from_camera, sightings);
  known_.key_frame.own = std::move(carried);
  known_.key_frame.own.insert(
      known_.key_frame.own.end(), added.begin(), added.end());
}

std::vector<LandmarkMatch> FastLocalizer::AsOwn(
    const std::vector<FollowedLandmark>& landmarks,
    const geometry::CameraModel& camera) {
  const geometry::Rigid3 camera_from_world =
      known_.key_frame.world_from_camera.Inverse();
  std::vector<SessionLandmarks::Sighting> sightings;
  for (const FollowedLandmark& landmark : landmarks) {
    const Eigen::Vector3d p_camera =
        camera_from_world * table().Position(landmark.match.landmark);
    const auto pixel_px = camera.ImageFromCamera(p_camera);
    if (!pixel_px || !camera.IsInsideImage(*pixel_px)) continue;
    sightings.push_back({*pixel_px, p_camera.z(), kScaleSigma});
  }
  return known_.own.Add(camera, known_.key_frame.world_from_camera, sightings);
}

void FastLocalizer::MoveOwnLandmarks() {
  known_.own.Move(known_.filter.pose(PoseFilter::kKeyFrame).world_from_camera *
                  known_.key_frame.world_from_camera.Inverse());
}

void FastLocalizer::AddOdometryDrift() {
  const auto left_map_at = known_.LeftMapAt();
  if (!left_map_at) return;
  const Eigen::Vector3d at_key =
      known_.filter.pose(PoseFilter::kKeyFrame).world_from_camera.translation;
  const Eigen::Vector3d step =
      known_.filter.pose().world_from_camera.translation - at_key;
  // What is not known of the depths errs alike: the ground slopes, or the pose
  // is tilted from which they were seen on it.
  std::vector<double> sigmas;
  for (const LandmarkMatch& match : known_.key_frame.own) {
    if (known_.own.Has(match.landmark)) {
      sigmas.push_back(known_.own.RelativeSigma(match.landmark));
    }
  }
  double scale_sigma = kScaleSigma;
  if (!sigmas.empty()) {
    const auto middle =
        sigmas.begin() + static_cast<std::ptrdiff_t>(sigmas.size() / 2);
    std::nth_element(sigmas.begin(), middle, sigmas.end());
    scale_sigma = std::max(scale_sigma, *middle);
  }
  const double way = (at_key - *left_map_at).norm();
  const double length = step.norm();
  if (!(length > 0.0)) return;
  // So that after a straight way of length w the variance is (sigma w)^2.
  geometry::Matrix6d drift = geometry::Matrix6d::Zero();
  drift.topLeftCorner<3, 3>() = scale_sigma * scale_sigma *
                                (2.0 * way / length + 1.0) * step *
                                step.transpose();
  known_.filter.AddDrift(drift);
}

}  // namespace groundlock::localization
