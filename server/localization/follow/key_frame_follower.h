// SPDX-License-Identifier: Apache-2.0
// Follows map landmarks from a key frame into the current frame by pyramidal
// Lucas-Kanade. Patches always come from the key frame, not from the frame
// before: their positions do not drift while the key frame is kept.
//
// follow/ holds what sees a camera move from image to image, without
// descriptors, in a millisecond:
//   key_frame_follower  where a key frame's landmarks are in this frame
//   blurred_patch       the same of one patch, where motion blurs the images
//   exposure_estimate   for how long they are exposed, from that blur
//   fresh_landmarks     which of the map's landmarks have come into view
//   session_landmarks   landmarks of the session's own, where the map has none
//   ground_depth        how far away they are if they lie on the map's ground
//   rotation_flow       how the camera turned, where no landmark is seen
//   frame_bridge        frames kept until an anchor comes, to carry it over
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_KEY_FRAME_FOLLOWER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_KEY_FRAME_FOLLOWER_H_

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <opencv2/core/types.hpp>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/luma_pyramid.h"
#include "server/localization/follow/exposure_estimate.h"
#include "server/localization/follow/session_landmarks.h"
#include "server/localization/localizer.h"
#include "server/localization/solvers/robust_pose.h"

namespace groundlock::localization {

// A landmark that is followed.
struct FollowedLandmark {
  LandmarkMatch match;
  // Its place was found by descriptor. False: it was projected through a pose
  // that others gave, and repeats that pose's error.
  bool is_anchored = true;
};

std::vector<LandmarkMatch> MatchesOf(
    std::span<const FollowedLandmark> landmarks);

// A frame whose landmarks' places are known.
struct KeyFrame {
  std::shared_ptr<const image::LumaPyramid> pyramid;
  std::vector<FollowedLandmark> landmarks;
  // The session's own (session_landmarks.h), where they were found.
  std::vector<LandmarkMatch> own;
  std::vector<LandmarkMatch> own_seen;  // in the frame last looked at for them
  geometry::Rigid3 world_from_camera;   // by which they were projected
  // Of the camera, as (dp, dtheta) per second, see rigid3.h.
  geometry::Vector6d velocity_s = geometry::Vector6d::Zero();
};

// Where the camera is, and how it moves while the frame is exposed.
struct MovingCamera {
  geometry::Rigid3 world_from_camera;
  geometry::Vector6d velocity_s = geometry::Vector6d::Zero();
  double exposure_s = 0.0;
  // Of (dp, dtheta), relative to the key frame, if it is a prediction of which
  // that is known.
  std::optional<geometry::Matrix6d> covariance = std::nullopt;

  std::optional<ExpectedPose> Expected() const {
    if (!covariance) return std::nullopt;
    return ExpectedPose{world_from_camera, *covariance};
  }
};

// Up to `max_landmarks` of `landmarks`, spread evenly over the image: one by
// one from the cells of a grid, anchored ones first, then those seen in most
// map views. Deterministic.
std::vector<FollowedLandmark> SpreadOverImage(
    const LandmarkTable& table,
    std::span<const FollowedLandmark> landmarks,
    cv::Size size_px,
    int max_landmarks);

// How far from where a landmark is expected it is looked for: near it; by a
// quarter of the image if need be, at the risk of something that looks alike;
// or as far as what is not known of its own place may put it.
enum class Reach { kNear, kFar, kUncertain };

// Where the key frame's landmarks are in `current`. The search starts where
// `predicted` projects them. Where the motion blurs the two frames differently,
// what Lucas-Kanade found is aligned anew (blurred_patch.h). Landmarks that
// leave the image or look different are left out.
//   kNear  a few landmarks, spread over the image, tell the pose more closely,
//     and with it where to look for all; none if those few do not agree.
//   kFar  some landmarks, spread over the image, enough for a pose.
//   kUncertain  all landmarks, for a pose that is known.
std::vector<FollowedLandmark> FollowLandmarks(
    const LandmarkTable& table,
    const KeyFrame& key_frame,
    const image::LumaPyramid& current,
    const geometry::CameraModel& camera,
    const MovingCamera& predicted,
    Reach reach);

// Tells `exposure` what `followed` says, landmarks that agree on the pose of
// `moving`; its exposure_s is not looked at.
void ObserveExposure(const LandmarkTable& table,
                     const KeyFrame& key_frame,
                     const image::LumaPyramid& current,
                     const geometry::CameraModel& camera,
                     const MovingCamera& moving,
                     std::span<const FollowedLandmark> followed,
                     ExposureEstimate& exposure);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_KEY_FRAME_FOLLOWER_H_
