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
#include "server/localization/camera_state.h"
#include "server/localization/key_frame_follower.h"
#include "server/localization/localizer.h"

namespace groundlock::localization {

struct FastLocalizerOptions {
  int max_followed_landmarks = 220;
  // A pose is TRACKED only if at least so many landmarks agree on it, in at
  // least so many cells of an 8 x 6 grid, and are this share of those followed.
  int min_inliers = 30;
  int min_cells = 6;
  double min_inlier_share = 0.4;
  // Below it, landmarks that come into view are added by projection and an
  // anchor is asked for.
  int healthy_inliers = 100;
  int max_frames_per_key_frame = 8;
  std::chrono::nanoseconds anchor_period = std::chrono::seconds(1);
  // When LocalizerOptions::wait_for_anchor: an anchor is adopted so many frames
  // after the frame that asked for it.
  int anchor_delay_frames = 4;
};

// The way of a frame: predict the pose (constant velocity), follow the key
// frame's landmarks, refine robustly, verify. Then, as needed, make this frame
// the key frame, and start an anchor (anchoring.h) in the background. When the
// anchor of an earlier frame arrives, that frame becomes the key frame with
// fresh, undrifted landmarks, which are followed into the current one.
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
  // Camera motion as last verified.
  struct Motion {
    geometry::Rigid3 world_from_camera;
    std::chrono::nanoseconds capture_time{0};
    Eigen::Vector3d velocity_world_s = Eigen::Vector3d::Zero();
    Eigen::Vector3d angular_velocity_world_rad_s = Eigen::Vector3d::Zero();

    geometry::Rigid3 Predict(std::chrono::nanoseconds time) const;
  };

  // An anchor under way; shared with the background task, which outlives us if
  // the session ends first.
  struct AnchorJob;

  struct Followed {
    std::vector<LandmarkMatch> matches;
    RobustPose pose;
  };

  void StartAnchor(const LocalizationRequest& request);
  // The pending anchor, if it is due and found something.
  std::shared_ptr<AnchorJob> TakeFinishedAnchor(std::uint64_t frame_index);
  // Makes the anchor's frame the key frame; returns the pose now.
  geometry::Rigid3 Adopt(const AnchorJob& job, std::chrono::nanoseconds now);
  // Finds the camera in this very frame through the map's descriptors.
  std::optional<Followed> AnchorNow(const LocalizationRequest& request);

  std::optional<Followed> Follow(const LocalizationRequest& request,
                                 const LumaPyramid& pyramid,
                                 const geometry::Rigid3& predicted) const;
  bool IsVerified(const Followed& followed,
                  const geometry::CameraModel& camera,
                  int min_inliers) const;
  void UpdateMotion(const RobustPose& pose,
                    std::chrono::nanoseconds capture_time);
  void MakeKeyFrame(const LocalizationRequest& request,
                    const Followed& followed);
  std::vector<LandmarkMatch> ProjectFreshLandmarks(
      const LocalizationRequest& request,
      const geometry::Rigid3& world_from_camera,
      const std::vector<LandmarkMatch>& known) const;

  static std::vector<LandmarkMatch> InliersOf(const Followed& followed);
  LocalizationResult TrackedResult(const Followed& followed,
                                   std::chrono::nanoseconds capture_time);
  LocalizationResult UnverifiedResult(std::chrono::nanoseconds capture_time);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  FastLocalizerOptions fast_options_;
  BackgroundRunner run_in_background_;
  CameraStateMachine state_;

  std::optional<Motion>
      motion_;  // unset before the first success and when lost
  KeyFrame key_frame_;
  int frames_since_key_frame_ = 0;
  std::size_t key_frame_landmarks_ = 0;  // when it was made
  std::uint64_t frame_index_ = 0;
  std::chrono::nanoseconds last_anchor_time_{0};
  std::shared_ptr<AnchorJob> pending_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
