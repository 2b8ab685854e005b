// SPDX-License-Identifier: Apache-2.0
// How FastLocalizer comes to anchors: asks for them, adopts them early or late,
// and carries a late one over the frames since.
#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "map_store/base/mix_seed.h"
#include "server/localization/fast_localizer.h"

namespace groundlock::localization {
namespace {

// An anchor later than this corrects the key frame instead of replacing it.
constexpr std::uint64_t kLateFrames = 8;
// A single frame with a longer side than this is taken for a photograph.
constexpr int kPhotographSide_px = 1'280;
// A camera is sought by other focal lengths, too, after so many searches in
// vain.
constexpr int kSearchesBeforeProbe = 2;
// After so many in vain, searches give way to frames.
constexpr int kUrgentSearches = 4;
// Beyond the map's end, one in so many anchors is sought in the whole map: that
// costs as much as the others together.
constexpr int kRefreshesPerSearch = 5;
// What translation does to a rotation by image corners: 0.5 m/s at 5 m.
constexpr double kFlowDrift_rad_s = 0.1;

using std::chrono::nanoseconds;

// Two poses as far apart still tell how the camera moves.
constexpr nanoseconds kMaxVelocityInterval = std::chrono::seconds(2);

double TurnSigma(nanoseconds duration) {
  return kFlowDrift_rad_s * std::chrono::duration<double>(duration).count();
}

std::vector<FollowedLandmark> AsAnchored(
    const std::vector<LandmarkMatch>& matches) {
  std::vector<FollowedLandmark> landmarks;
  landmarks.reserve(matches.size());
  for (const LandmarkMatch& match : matches) {
    landmarks.push_back({match, /*is_anchored=*/true});
  }
  return landmarks;
}

}  // namespace

AnchorTask FastLocalizer::TaskFor(const LocalizationRequest& request) const {
  AnchorTask task;
  task.request.luma = request.frame->luma;
  task.request.camera = request.camera;
  task.request.masks_px = request.masks_px;
  task.request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  task.request.prior = request.prior;
  task.request.wants_lens_matches = lens_check_.WantsMore();
  if (has_pose_) {
    task.request.prior_world_from_camera = filter_.pose().world_from_camera;
  }
  task.options.is_photograph =
      options_.wait_for_anchor && !has_pose_ &&
      std::max(request.frame->luma.cols, request.frame->luma.rows) >
          kPhotographSide_px;
  task.options.min_landmark_views = options_.min_landmark_views;
  task.options.sift_contrast_threshold = options_.sift_contrast_threshold;
  task.options.max_features =
      std::min(task.options.max_features, options_.max_features);
  return task;
}

AnchorTask FastLocalizer::SearchTaskFor(const LocalizationRequest& request) {
  AnchorTask task = TaskFor(request);
  if (failed_searches_ >= kSearchesBeforeProbe) {
    task.probe_focal_ratio = lens_check_.NextProbe();
  }
  return task;
}

bool FastLocalizer::IsPendingOutdated() const {
  return !is_pending_a_search_ &&
         frame_index_ > pending_->frame_index + kLateFrames;
}

void FastLocalizer::DropPending() {
  if (pending_) WithdrawAnchorJob(*pending_);
  pending_.reset();
}

void FastLocalizer::StartSearch(const LocalizationRequest& request) {
  DropPending();
  // A camera that is nowhere in the map must not keep a core busy.
  StartAnchor(
      SearchTaskFor(request),
      request,
      failed_searches_ < kUrgentSearches ? Urgency::kNow : Urgency::kLater);
  is_pending_a_search_ = true;
}

void FastLocalizer::StartRefresh(const LocalizationRequest& request) {
  // A frame will wait for it: a thread that gives way to other programs would
  // hold up the session (priority inversion).
  AnchorTask task = TaskFor(request);
  // Odometry mostly knows well enough where the camera is.
  task.options.search_anywhere =
      !left_map_at_ ||
      failed_refreshes_ % kRefreshesPerSearch == kRefreshesPerSearch - 1;
  StartAnchor(std::move(task),
              request,
              options_.wait_for_anchor ? Urgency::kNow : Urgency::kLater);
  is_pending_a_search_ = false;
}

void FastLocalizer::StartAnchor(AnchorTask task,
                                const LocalizationRequest& request,
                                Urgency urgency) {
  BeginAnchor(request);
  pending_ = StartAnchorJob(map_,
                            std::move(task),
                            *request.frame,
                            frame_index_,
                            urgency,
                            run_in_background_);
}

bool FastLocalizer::RenewAnchor(const LocalizationRequest& request) {
  if (!is_pending_a_search_ ||
      !RenewAnchorJob(
          TaskFor(request), *request.frame, frame_index_, *pending_)) {
    return false;
  }
  BeginAnchor(request);
  return true;
}

void FastLocalizer::BeginAnchor(const LocalizationRequest& request) {
  filter_.Forget(PoseFilter::kAnchorFrame);
  if (has_pose_) filter_.Remember(PoseFilter::kAnchorFrame);
  pending_velocity_s_.setZero();
  if (has_pose_) pending_velocity_s_ = filter_.velocity_s();
  last_anchor_time_ = request.frame->capture_time;
  last_anchor_frame_ = frame_index_;
  bridge_.reset();
  pending_own_.clear();
  pending_masks_px_ = request.masks_px;
}

MapMeasurement FastLocalizer::Measured(const FoundAnchor& found) {
  MapMeasurement measured = found.pose.measured;
  std::vector<std::uint32_t> landmarks = LandmarksOf(found.inliers);
  measured.shared = SharedLandmarks(landmarks, last_anchor_landmarks_);
  last_anchor_landmarks_ = std::move(landmarks);
  return measured;
}

void FastLocalizer::AdoptFinishedAnchor() {
  if (!pending_) return;
  if (options_.wait_for_anchor) {
    const auto delay =
        static_cast<std::uint64_t>(fast_options_.anchor_delay_frames);
    if (frame_index_ < pending_->frame_index + delay) return;
    FinishAnchorJob(*pending_);
  } else if (!IsFinished(*pending_)) {
    return;
  }
  const auto job = std::exchange(pending_, nullptr);
  if (job->sought.lens) lens_check_.Add(*job->sought.lens);
  if (!job->sought.found) {
    ++(is_pending_a_search_ ? failed_searches_ : failed_refreshes_);
    return;
  }
  failed_searches_ = 0;
  failed_refreshes_ = 0;
  const MapMeasurement measured = Measured(*job->sought.found);
  const bool is_late = frame_index_ > job->frame_index + kLateFrames;
  if (!has_pose_ || !filter_.Remembers(PoseFilter::kAnchorFrame) ||
      (is_late && !is_following_)) {
    // Its own frame is past; what is known of the motion since, the frames that
    // were kept tell.
    StartFrom(*job, measured);
  } else {
    const bool agrees =
        filter_.UpdateFromMap(PoseFilter::kAnchorFrame, measured);
    if (!agrees) filter_.RestartFromMap(PoseFilter::kAnchorFrame, measured);
    // What odometry has gathered of error goes in one frame.
    const bool ends_odometry = left_map_at_.has_value();
    if (!agrees || ends_odometry) state_.NoteJump();
    left_map_at_.reset();
    MoveOwnLandmarks();
    bridge_.reset();
    if (is_late) {
      CorrectKeyFrame(*job, ends_odometry);
      return;
    }
    filter_.MakeAnchorFrameKeyFrame();
  }
  SetKeyFrame(job->pyramid,
              job->camera,
              filter_.pose(PoseFilter::kKeyFrame).world_from_camera,
              pending_velocity_s_,
              AsAnchored(job->sought.found->inliers));
  SetOwnLandmarks(job->camera, pending_masks_px_, std::move(pending_own_));
  key_frames_since_anchor_ = 0;
}

void FastLocalizer::StartFrom(const AnchorJob& job,
                              const MapMeasurement& measured) {
  if (has_pose_) state_.NoteJump();
  geometry::Vector6d velocity_s = geometry::Vector6d::Zero();
  const auto& before = state_.last();
  if (before && job.capture_time > before->time &&
      job.capture_time - before->time <= kMaxVelocityInterval) {
    velocity_s =
        PoseDifference(before->world_from_camera, measured.world_from_camera) /
        std::chrono::duration<double>(job.capture_time - before->time).count();
  }
  filter_.Start(job.capture_time, measured, velocity_s);
  filter_.Remember(PoseFilter::kKeyFrame);
  pending_velocity_s_ = velocity_s;
  const PoseEstimate pose = filter_.pose();
  state_.Verify(job.capture_time,
                pose.world_from_camera,
                pose.covariance,
                MeanDistance(job.sought.found->inliers,
                             pose.world_from_camera.translation));
  has_pose_ = true;
  left_map_at_.reset();
  own_.Clear();
  pending_own_.clear();
}

void FastLocalizer::CorrectKeyFrame(const AnchorJob& job, bool ends_odometry) {
  const std::vector<std::uint32_t> anchored =
      LandmarksOf(job.sought.found->inliers);
  std::vector<FollowedLandmark> landmarks = key_frame_.landmarks;
  for (FollowedLandmark& landmark : landmarks) {
    landmark.is_anchored |= std::binary_search(
        anchored.begin(), anchored.end(), landmark.match.landmark);
  }
  if (ends_odometry) {
    // The key frame has none of the map's: they lie where its pose, which is
    // now right, projects them.
    for (const LandmarkMatch& match : job.sought.found->inliers) {
      landmarks.push_back({match, /*is_anchored=*/false});
    }
  }
  const int frames_since_key_frame = frames_since_key_frame_;
  std::vector<LandmarkMatch> own = std::move(key_frame_.own);
  SetKeyFrame(key_frame_.pyramid,
              job.camera,
              filter_.pose(PoseFilter::kKeyFrame).world_from_camera,
              key_frame_.velocity_s,
              std::move(landmarks));
  key_frame_.own = std::move(own);
  frames_since_key_frame_ = frames_since_key_frame;
  key_frames_since_anchor_ = 0;
  filter_.Forget(PoseFilter::kAnchorFrame);
}

void FastLocalizer::AddToBridge(
    const LocalizationRequest& request,
    const std::optional<Eigen::Quaterniond>& before_from_now) {
  if (!bridge_) {
    bridge_.emplace();
    bridge_->Begin(frame_index_ == pending_->frame_index + 1);
  }
  bridge_->Add(*request.frame, before_from_now);
}

void FastLocalizer::CrossBridge(const LocalizationRequest& request,
                                const std::optional<GyroscopeTurn>& gyro) {
  if (!bridge_) return;
  const FrameBridge bridge = *std::exchange(bridge_, std::nullopt);
  if (!has_pose_) return;
  LocalizationRequest past = request;
  past.prior.reset();
  std::optional<Eigen::Quaterniond> last_turn;
  if (gyro) {
    last_turn = gyro->before_from_now;
  } else if (const auto flow = TurnSinceLastFrame(request)) {
    last_turn = flow->before_from_now;
  }
  bool is_following = true;
  const auto turn = [&](nanoseconds time,
                        const std::optional<Eigen::Quaterniond>& step) {
    const nanoseconds duration = time - filter_.time();
    filter_.Remember(PoseFilter::kLastFrame);
    filter_.Propagate(time);
    if (!step) return;
    filter_.UpdateRotation(PoseFilter::kLastFrame, *step, TurnSigma(duration));
  };
  for (const FrameBridge::Step& step : bridge.steps()) {
    turn(step.frame.capture_time, step.before_from_now);
    if (!is_following) continue;
    past.frame = &step.frame;
    auto followed = Follow(past);
    if (!followed) followed = FollowFar(past);
    is_following = followed.has_value();
    if (!is_following) continue;
    MakeKeyFrame(past, *followed);
    key_frames_since_anchor_ = 0;
  }
  std::optional<Eigen::Quaterniond> to_now;
  if (last_turn) {
    to_now = Chain(bridge.turn_since_last_step(), *last_turn);
  }
  turn(request.frame->capture_time, to_now);
  // Of the frame before, only the pyramid is known.
  filter_.Forget(PoseFilter::kLastFrame);
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorNow(
    const LocalizationRequest& request) {
  DropPending();
  filter_.Forget(PoseFilter::kAnchorFrame);
  last_anchor_time_ = request.frame->capture_time;
  last_anchor_frame_ = frame_index_;
  const auto [found, lens] = SeekAnchor(*map_, SearchTaskFor(request));
  if (lens) lens_check_.Add(*lens);
  if (!found) {
    ++failed_searches_;
    return std::nullopt;
  }
  key_frames_since_anchor_ = 0;
  own_.Clear();
  key_frame_.own.clear();
  left_map_at_.reset();
  const MapMeasurement measured = Measured(*found);
  if (!has_pose_) {
    filter_.Start(request.frame->capture_time, measured);
  } else if (!filter_.UpdateFromMap(measured)) {
    filter_.Start(request.frame->capture_time, measured);
    state_.NoteJump();
  }
  has_pose_ = true;
  Followed followed;
  followed.inliers = AsAnchored(found->inliers);
  followed.num_anchored_inliers = static_cast<int>(found->inliers.size());
  followed.mean_error_px = found->pose.pose.mean_error_px;
  return followed;
}

}  // namespace groundlock::localization
