// SPDX-License-Identifier: Apache-2.0
// Localisation in real time: landmarks are followed from frame to frame, and
// re-anchored to the map's descriptors off the frame path.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_

#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include "server/localization/anchoring.h"
#include "server/localization/camera_motion_filter.h"
#include "server/localization/camera_state.h"
#include "server/localization/key_frame_follower.h"
#include "server/localization/localizer.h"
#include "server/localization/pose_estimate.h"

namespace groundlock::localization {

struct FastLocalizerOptions {
  int max_followed_landmarks = 220;
  // A pose is TRACKED only if at least so many landmarks agree on it, in at
  // least so many cells of an 8 x 6 grid, and are this share of those followed.
  int min_inliers = 30;
  int min_cells = 6;
  double min_inlier_share = 0.4;
  // Below so many anchored inliers, landmarks that come into view are added by
  // projection, and an anchor is asked for.
  int healthy_inliers = 110;
  int max_frames_per_key_frame = 10;
  // Each change of key frame adds a little drift.
  int max_key_frames_per_anchor = 2;
  std::chrono::nanoseconds anchor_period = std::chrono::seconds(1);
  // When LocalizerOptions::wait_for_anchor: an anchor is adopted so many frames
  // after the frame that asked for it.
  int anchor_delay_frames = 4;
  // Anchors are not asked for more often, however much comes into view.
  int min_frames_between_anchors = 6;
};

// The way of a frame: predict the pose (constant velocity), follow the key
// frame's landmarks, refine robustly, verify. Then, as needed, make this frame
// the key frame, and start an anchor (anchoring.h) in the background. When the
// anchor of an earlier frame arrives, it is fused with the pose that was
// followed into that frame, by their covariances; that frame becomes the key
// frame, and its landmarks are followed into the current one.
//
// A key frame's landmarks lie where its pose projects them, not where they were
// found: what is followed is then the camera's motion since the key frame,
// exact to a fraction of a pixel, and the error of a single landmark (its
// feature's, its position's) enters only through the key frame's pose, which
// all of an anchor's landmarks determine together.
class FastLocalizer : public Localizer {
 public:
  FastLocalizer(std::shared_ptr<const map::Map> map,
                const LocalizerOptions& options,
                const FastLocalizerOptions& fast_options,
                BackgroundRunner run_in_background);
  ~FastLocalizer() override;

  absl::StatusOr<LocalizationResult> Localize(
      const LocalizationRequest& request) override;
  void Reset() override;

 private:
  // An anchor under way; shared with the background task, which outlives us if
  // the session ends first.
  struct AnchorJob;

  struct Followed {
    std::vector<FollowedLandmark> landmarks;
    RobustPose pose;
    // Of the pose relative to the key frame's.
    geometry::Matrix6d relative_covariance = geometry::Matrix6d::Zero();
    // Found in this frame by descriptors: not relative to a key frame.
    std::optional<PoseEstimate> anchor;

    int num_anchored_inliers = 0;
  };

  //   is_tracked  the pose was verified in this frame.
  void StartAnchor(const LocalizationRequest& request, bool is_tracked);
  // The pending anchor, if it is due and found something.
  std::shared_ptr<AnchorJob> TakeFinishedAnchor(std::uint64_t frame_index);
  // Makes the anchor's frame the key frame; returns the pose now.
  geometry::Rigid3 Adopt(const AnchorJob& job, std::chrono::nanoseconds now);
  // Finds the camera in this very frame through the map's descriptors.
  std::optional<Followed> AnchorNow(const LocalizationRequest& request);

  std::optional<Followed> Follow(const LocalizationRequest& request,
                                 const image::LumaPyramid& pyramid,
                                 const geometry::Rigid3& predicted) const;
  bool IsVerified(const Followed& followed,
                  const geometry::CameraModel& camera,
                  int min_inliers) const;
  // Filters the measured pose by the camera's motion; sets the pose now.
  void UpdateMotion(const Followed& followed,
                    std::chrono::nanoseconds capture_time);
  void SetKeyFrame(std::shared_ptr<const image::LumaPyramid> pyramid,
                   const geometry::CameraModel& camera,
                   const PoseEstimate& pose,
                   std::vector<FollowedLandmark> landmarks);
  // Of an anchor's pose: what its matches have in common is not in their
  // spread.
  geometry::Matrix6d AnchorCovariance(const Anchor& anchor) const;
  void MakeKeyFrame(const LocalizationRequest& request,
                    const Followed& followed);
  std::vector<FollowedLandmark> ProjectFreshLandmarks(
      const LocalizationRequest& request,
      const geometry::Rigid3& world_from_camera,
      const std::vector<FollowedLandmark>& known) const;

  static std::vector<FollowedLandmark> InliersOf(const Followed& followed);
  LocalizationResult TrackedResult(const Followed& followed,
                                   std::chrono::nanoseconds capture_time);
  LocalizationResult UnverifiedResult(std::chrono::nanoseconds capture_time);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  FastLocalizerOptions fast_options_;
  BackgroundRunner run_in_background_;
  CameraStateMachine state_;

  // Unset before the first success and when lost.
  std::optional<PoseEstimate> pose_;
  CameraMotionFilter motion_;
  KeyFrame key_frame_;
  PoseEstimate key_frame_pose_;
  int frames_since_key_frame_ = 0;
  int key_frames_since_anchor_ = 0;
  std::size_t key_frame_landmarks_ = 0;  // when it was made
  std::uint64_t frame_index_ = 0;
  std::chrono::nanoseconds last_anchor_time_{0};
  std::uint64_t last_anchor_frame_ = 0;
  std::shared_ptr<AnchorJob> pending_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
