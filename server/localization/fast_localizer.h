// SPDX-License-Identifier: Apache-2.0
// Localisation in real time: landmarks are followed from frame to frame, and
// re-anchored to the map's descriptors off the frame path.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_

#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/localization/fast_localizer_state.h"
#include "server/localization/follow/rotation_flow.h"
#include "server/localization/localizer.h"
#include "server/localization/search/anchor_job.h"

namespace groundlock::localization {

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
  // options: valid (see CreateLocalizer).
  FastLocalizer(std::shared_ptr<const map::Map> map,
                const LocalizerOptions& options,
                BackgroundRunner run_in_background);
  ~FastLocalizer() override;

  absl::StatusOr<LocalizationResult> Localize(
      const LocalizationRequest& request) override;
  void Reset() override;
  std::string Save() const override;
  absl::Status Restore(std::string_view state) override;

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
  // What a frame has brought to light so far.
  struct FrameWork {
    const LocalizationRequest& request;
    std::optional<GyroscopeTurn> gyro;  // since the frame before
    // The same by image corners, as far as that was asked.
    std::optional<FlowRotation> turn = std::nullopt;
    bool anchored = false;  // in this very frame
  };
  // A way to find the camera in a frame; nullopt where it does not.
  using Attempt = std::optional<Followed> (FastLocalizer::*)(FrameWork& work);
  // What a frame's pose is verified by.
  enum class Support { kMap, kMapAndOwn };

  // What is tried in a frame, in this order: the table in
  // fast_localizer_state.h.
  std::span<const Attempt> Attempts() const;
  std::optional<Followed> FollowExpected(FrameWork& work);
  std::optional<Followed> FollowByTurn(FrameWork& work);
  std::optional<Followed> AnchorInFrame(FrameWork& work);
  std::optional<Followed> LeaveMap(FrameWork& work);
  // A frame without a pose is itself sought in the map; else in the background.
  bool AnchorsInFrame() const {
    return options_.wait_for_anchor || !run_in_background_;
  }
  void SearchInBackground(FrameWork& work);

  // What an anchor needs of a frame; the same for both kinds.
  AnchorTask TaskFor(const LocalizationRequest& request) const;
  // The same; now and then by another lens, too.
  AnchorTask SearchTaskFor(const LocalizationRequest& request);
  // A pending search that is not under way yet is done in this frame.
  bool RenewAnchor(const LocalizationRequest& request);
  // This frame is the one whose anchor is asked for.
  void BeginAnchor(AnchorTask task,
                   const LocalizationRequest& request,
                   bool is_search);
  // An anchor that was to keep a pose fresh: not worth waiting for, now that no
  // landmarks are followed any more.
  bool IsPendingOutdated() const;
  void DropPending();
  void StartSearch(const LocalizationRequest& request);
  void StartRefresh(const LocalizationRequest& request);
  void StartAnchor(AnchorTask task,
                   const LocalizationRequest& request,
                   bool is_search);
  // Puts a thread to what is pending.
  void SeekPending();
  // Takes in the pending anchor, if it is due and found something.
  void AdoptFinishedAnchor();
  // The camera was where the anchor says, whatever was thought before.
  void StartFrom(const PendingAnchor& asked,
                 const FoundAnchor& found,
                 const MapMeasurement& measured);
  // An anchor that comes late corrects the key frame that is followed: its own
  // frame is too far away to follow landmarks from.
  //   camera  of the anchor's frame.
  void CorrectKeyFrame(const geometry::CameraModel& camera,
                       const FoundAnchor& found,
                       bool ends_odometry);
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
  MapMeasurement Measured(const FoundAnchor& found) const;
  // Whether another frame is to find the same before anybody is told.
  bool WantsConfirmation(const FoundAnchor& found) const;
  // Another anchor that wants confirmation contradicts what is known: whether
  // that is to be given up.
  bool BeginsToDoubt();
  // Takes an anchor in where its own frame is remembered. False if it is left
  // out: it contradicts what is followed, and little agrees with it.
  bool TakeIn(const FoundAnchor& found, const MapMeasurement& measured);
  // What is known of the camera begins with an anchor that contradicts what was
  // known before, or is the first.
  void BeginAnew(bool wants_confirmation);
  // What is followed since is told from now on.
  void Confirm();

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
  // Where the camera sees the key frame's landmarks that no mask hides.
  std::vector<Eigen::Vector2d> InView(const KeyFrame& key_frame,
                                      const geometry::Rigid3& world_from_camera,
                                      const LocalizationRequest& request) const;
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
  // What other sensors say is a measurement of this frame's pose; what
  // contradicts what is known of it is left out.
  void TakeInPrior(const PosePrior& prior);
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
  LandmarkTable table() const { return {*map_, &known_.own}; }
  LocalizationResult TrackedResult(const Followed& followed,
                                   std::chrono::nanoseconds capture_time);
  // Of a frame that was followed, while nobody is told where from.
  LocalizationResult TentativeResult(
      std::chrono::nanoseconds capture_time) const;
  LocalizationResult UnverifiedResult(std::chrono::nanoseconds capture_time);

  std::shared_ptr<const map::Map> map_;
  LocalizerOptions options_;
  BackgroundRunner run_in_background_;
  FastLocalizerState known_;
  // Seeks known_.pending; null if that is unset.
  std::shared_ptr<AnchorJob> job_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_H_
