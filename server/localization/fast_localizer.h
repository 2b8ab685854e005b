// SPDX-License-Identifier: Apache-2.0
// Localisation in real time: landmarks are followed from frame to frame, and
// re-anchored to the map's descriptors off the frame path.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "server/image/luma_pyramid.h"
#include "server/localization/anchor_job.h"
#include "server/localization/camera_state.h"
#include "server/localization/frame_bridge.h"
#include "server/localization/gyroscope.h"
#include "server/localization/key_frame_follower.h"
#include "server/localization/lens_check.h"
#include "server/localization/localizer.h"
#include "server/localization/pose_filter.h"
#include "server/localization/rotation_flow.h"
#include "server/localization/session_landmarks.h"

namespace groundlock::localization {

struct FastLocalizerOptions {
  int max_followed_landmarks = 220;
  // A pose is TRACKED only if at least so many landmarks agree on it, in at
  // least so many cells of an 8 x 6 grid, and are this share of those followed.
  int min_inliers = 30;
  int min_cells = 6;
  double min_inlier_share = 0.4;
  // Below so many anchored inliers an anchor is asked for.
  int healthy_inliers = 110;
  // With fewer anchored inliers, a new key frame also takes in landmarks that
  // have come into view, by projection.
  int full_inliers = 200;
  int max_frames_per_key_frame = 30;
  // Each change of key frame adds a little drift.
  int max_key_frames_per_anchor = 2;
  std::chrono::nanoseconds anchor_period = std::chrono::seconds(1);
  // When LocalizerOptions::wait_for_anchor: an anchor is adopted so many frames
  // after the frame that asked for it.
  int anchor_delay_frames = 4;
  // Anchors are not asked for more often, however much comes into view.
  int min_frames_between_anchors = 12;
  // In hurried frames (LocalizationRequest) so many times as rarely.
  int hurried_anchor_factor = 4;
  // Of the session's own (session_landmarks.h), where the map has none; 0:
  // none, and no odometry. They are observed every so many frames.
  int max_own_landmarks = 160;
  int frames_per_observation = 5;
  int frames_per_odometry_observation = 2;
};

// The way of a frame: predict the pose (pose_filter.h), follow the key frame's
// landmarks, refine robustly, verify. Then, as needed, make this frame the key
// frame, and start an anchor (anchor_job.h) in the background. When the anchor
// of an earlier frame arrives, the filter takes it in as a measurement of that
// frame's pose; that frame becomes the key frame, and its landmarks are
// followed into the current one. A frame in which nothing is verified keeps the
// rotation that image corners follow, and the filter's motion.
//
// Where the map has nothing to follow, corners of the image are, and are
// triangulated while the map still tells where the camera is. When the map's
// landmarks verify nothing any more, these together with what is left of them
// say how the camera moved since the key frame: that is odometry. It ends when
// an anchor is found.
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
  struct Followed {
    std::vector<FollowedLandmark> inliers;  // of the map
    std::vector<LandmarkMatch> own_inliers;
    double mean_error_px = 0.0;
    int num_anchored_inliers = 0;
    bool by_map = true;  // else by odometry

    std::size_t num_inliers() const {
      return inliers.size() + own_inliers.size();
    }
  };
  // What a frame's pose is verified by.
  enum class Support { kMap, kMapAndOwn };

  // What an anchor needs of a frame; the same for both kinds.
  AnchorTask TaskFor(const LocalizationRequest& request) const;
  // The same; now and then by another lens, too.
  AnchorTask SearchTaskFor(const LocalizationRequest& request);
  // A pending search that is not under way yet is done in this frame.
  bool RenewAnchor(const LocalizationRequest& request);
  // Whatever refers to the frame of an anchor that is asked for now.
  void BeginAnchor(const LocalizationRequest& request);
  // An anchor that was to keep a pose fresh: not worth waiting for, now that no
  // landmarks are followed any more.
  bool IsPendingOutdated() const;
  void DropPending();
  void StartSearch(const LocalizationRequest& request);
  void StartRefresh(const LocalizationRequest& request);
  void StartAnchor(AnchorTask task,
                   const LocalizationRequest& request,
                   Urgency urgency);
  // Takes in the pending anchor, if it is due and found something.
  void AdoptFinishedAnchor();
  // The camera was where the job's anchor says, whatever was thought before.
  void StartFrom(const AnchorJob& job, const MapMeasurement& measured);
  // An anchor that comes late corrects the key frame that is followed: its own
  // frame is too far away to follow landmarks from.
  void CorrectKeyFrame(const AnchorJob& job, bool ends_odometry);
  // Keeps the frame until the anchor under way arrives.
  void AddToBridge(const LocalizationRequest& request,
                   const std::optional<Eigen::Quaterniond>& before_from_now);
  // Follows the landmarks of an anchor's frame over the frames that were kept
  // since, making each the key frame in turn, as far as they are verified; from
  // there on, and up to this frame, the camera turned as the image says.
  //   gyro  since the frame before, as the gyroscope says.
  void CrossBridge(const LocalizationRequest& request,
                   const std::optional<GyroscopeTurn>& gyro);
  // Finds the camera in this very frame through the map's descriptors.
  std::optional<Followed> AnchorNow(const LocalizationRequest& request);
  // The measurement, with what it shares with the anchor before.
  MapMeasurement Measured(const FoundAnchor& found);

  // Follows the key frame's landmarks and takes the pose in; nullopt, and no
  // change, unless it is verified.
  std::optional<Followed> Follow(const LocalizationRequest& request);
  // The same where the camera may have moved by a quarter of the image since,
  // or in a way that nobody expects: looks for the camera first.
  std::optional<Followed> FollowFar(const LocalizationRequest& request);
  // By the session's own landmarks as well.
  std::optional<Followed> FollowOdometry(const LocalizationRequest& request);
  std::optional<Followed> FollowFrom(const MovingCamera& predicted,
                                     const LocalizationRequest& request,
                                     Support support);
  // The key frame with those of its own landmarks whose depth is known well
  // enough to say where the camera is.
  KeyFrame WithOwnLandmarks(const MovingCamera& predicted,
                            const geometry::CameraModel& camera) const;
  // As RefinePoseRobustly wants them: what is seen of the session's own
  // landmarks is taken relative to the key frame, and weighs what its depth
  // allows.
  std::vector<PoseObservation> Observations(
      const std::vector<FollowedLandmark>& seen,
      const MovingCamera& predicted,
      const geometry::CameraModel& camera) const;
  // As seen from the pose by which the key frame's landmarks were projected.
  MovingCamera PredictedCamera() const;
  bool CanFollowInto(const image::Frame& frame) const;
  // Followed by whatever of these helps first: near where it is expected, by
  // what odometry has (once the map is left), or far from there.
  std::optional<Followed> FollowFromExpected(
      const LocalizationRequest& request);
  // The same where a gyroscope has told how the camera turned since the frame
  // before; where that leads nowhere, as if it had not.
  std::optional<Followed> FollowByGyroscope(const LocalizationRequest& request,
                                            const GyroscopeTurn& turn);
  // Since the frame before, by the samples up to this one.
  std::optional<GyroscopeTurn> TakeInGyroscope(
      const LocalizationRequest& request);
  // By image corners.
  std::optional<FlowRotation> TurnSinceLastFrame(
      const LocalizationRequest& request);
  // The landmarks lie where `world_from_camera` projects them.
  void SetKeyFrame(std::shared_ptr<const image::LumaPyramid> pyramid,
                   const geometry::CameraModel& camera,
                   const geometry::Rigid3& world_from_camera,
                   const geometry::Vector6d& velocity_s,
                   std::vector<FollowedLandmark> landmarks);
  void MakeKeyFrame(const LocalizationRequest& request,
                    const Followed& followed);
  void KeepUp(const LocalizationRequest& request,
              const Followed& followed,
              bool anchored);

  // Where the key frame's own landmarks are in this frame, whose pose is known;
  // they are triangulated anew.
  std::vector<LandmarkMatch> ObserveOwn(const LocalizationRequest& request);
  // Own landmarks `carried` into the key frame, which has just been set, and
  // new ones where nothing is followed.
  void SetOwnLandmarks(const geometry::CameraModel& camera,
                       std::span<const geometry::Box2> masks_px,
                       std::vector<LandmarkMatch> carried);
  // Landmarks of the map that are to be followed like the session's own, from
  // the key frame, which has just been set.
  std::vector<LandmarkMatch> AsOwn(
      const std::vector<FollowedLandmark>& landmarks,
      const geometry::CameraModel& camera);
  // The filter has moved the key frame since it was set: so the landmarks that
  // were seen from it.
  void MoveOwnLandmarks();
  // What odometry does not see of its own error, in the way since the key
  // frame.
  void AddOdometryDrift();

  // From `center_world` to the landmarks, unit of the map.
  double MeanDistance(const std::vector<LandmarkMatch>& matches,
                      const Eigen::Vector3d& center_world) const;
  LandmarkTable table() const { return {*map_, &own_}; }
  LocalizationResult TrackedResult(const Followed& followed,
                                   std::chrono::nanoseconds capture_time);
  LocalizationResult UnverifiedResult(std::chrono::nanoseconds capture_time);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  FastLocalizerOptions fast_options_;
  BackgroundRunner run_in_background_;
  CameraStateMachine state_;

  // Meaningful while has_pose_: false before the first success and when lost.
  PoseFilter filter_;
  bool has_pose_ = false;
  SessionLandmarks own_;  // as seen from key_frame_.world_from_camera
  // Where the map was left; unset while it is followed.
  std::optional<Eigen::Vector3d> left_map_at_;
  ExposureEstimate exposure_;  // of whatever camera sends the frames
  KeyFrame key_frame_;
  int frames_since_key_frame_ = 0;
  int key_frames_since_anchor_ = 0;
  // When it was made, or the most that odometry has followed from it.
  std::size_t key_frame_landmarks_ = 0;
  std::uint64_t frame_index_ = 0;
  std::chrono::nanoseconds last_anchor_time_{0};
  std::uint64_t last_anchor_frame_ = 0;
  std::vector<std::uint32_t> last_anchor_landmarks_;  // sorted
  std::shared_ptr<AnchorJob> pending_;
  bool is_pending_a_search_ = false;  // else it keeps a pose fresh
  int failed_searches_ = 0;           // in a row
  int failed_refreshes_ = 0;
  // In the pending anchor's frame.
  std::vector<LandmarkMatch> pending_own_;
  std::vector<geometry::Box2> pending_masks_px_;
  // Of the camera in the pending anchor's frame.
  geometry::Vector6d pending_velocity_s_ = geometry::Vector6d::Zero();

  // Since the pending anchor's frame, while none is verified.
  std::optional<FrameBridge> bridge_;
  bool is_following_ = false;  // the frame before was verified

  LensCheck lens_check_;
  std::optional<Gyroscope> gyroscope_;  // unset: there is none
  // Frames in which the camera was found without the gyroscope only, less those
  // of a turn in which it was found with it.
  int gyroscope_contradictions_ = 0;
  std::chrono::nanoseconds last_time_{-1};  // of the frame before; < 0: none
  // Of the frame before; how the camera turned to it, as far as that was asked.
  std::shared_ptr<const image::LumaPyramid> last_pyramid_;
  Eigen::Quaterniond last_turn_ = Eigen::Quaterniond::Identity();
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
