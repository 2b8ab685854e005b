// SPDX-License-Identifier: Apache-2.0
// How FastLocalizer comes to anchors: asks for them, adopts them early or late,
// and carries a late one over the frames since.
#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "map_store/base/mix_seed.h"
#include "server/localization/fast_localizer.h"
#include "server/localization/window/seconds.h"

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
// So many anchors in a row, of which none is sure, make a camera doubtful that
// was known: a picture that hangs elsewhere is found again and again.
constexpr int kContradictionsToDoubt = 4;
// What translation does to a rotation by image corners: 0.5 m/s at 5 m.
constexpr double kFlowDrift_rad_s = 0.1;

using std::chrono::nanoseconds;

// Two poses as far apart still tell how the camera moves.
constexpr nanoseconds kMaxVelocityInterval = std::chrono::seconds(2);

double TurnSigma(nanoseconds duration) {
  return kFlowDrift_rad_s * Seconds(duration);
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
  task.request.wants_lens_matches = known_.lens_check.WantsMore();
  if (known_.HasPose()) {
    task.request.prior_world_from_camera =
        known_.filter.pose().world_from_camera;
  }
  task.options = AnchorOptionsFor(options_);
  task.options.is_photograph =
      options_.wait_for_anchor && !known_.HasPose() &&
      std::max(request.frame->luma.cols, request.frame->luma.rows) >
          kPhotographSide_px;
  return task;
}

AnchorTask FastLocalizer::SearchTaskFor(const LocalizationRequest& request) {
  AnchorTask task = TaskFor(request);
  if (known_.failed_searches >= kSearchesBeforeProbe) {
    task.probe_focal_ratio = known_.lens_check.NextProbe();
  }
  return task;
}

bool FastLocalizer::IsPendingOutdated() const {
  return !known_.pending->is_search &&
         known_.frame_index > known_.pending->frame_index + kLateFrames;
}

void FastLocalizer::DropPending() {
  if (job_) WithdrawAnchorJob(*job_);
  job_.reset();
  known_.pending.reset();
}

void FastLocalizer::StartSearch(const LocalizationRequest& request) {
  DropPending();
  StartAnchor(SearchTaskFor(request), request, /*is_search=*/true);
}

void FastLocalizer::StartRefresh(const LocalizationRequest& request) {
  AnchorTask task = TaskFor(request);
  // Odometry mostly knows well enough where the camera is.
  task.options.search_anywhere =
      !known_.LeftMapAt() ||
      known_.failed_refreshes % kRefreshesPerSearch == kRefreshesPerSearch - 1;
  StartAnchor(std::move(task), request, /*is_search=*/false);
}

void FastLocalizer::StartAnchor(AnchorTask task,
                                const LocalizationRequest& request,
                                bool is_search) {
  BeginAnchor(std::move(task), request, is_search);
  SeekPending();
}

void FastLocalizer::SeekPending() {
  const PendingAnchor& pending = *known_.pending;
  // A camera that is nowhere in the map must not keep a core busy. A frame that
  // will wait must not wait for a thread that gives way to other programs
  // (priority inversion).
  const bool is_urgent = pending.is_search
                             ? known_.failed_searches < kUrgentSearches
                             : options_.wait_for_anchor;
  job_ = StartAnchorJob(map_,
                        pending.task,
                        is_urgent ? Urgency::kNow : Urgency::kLater,
                        run_in_background_);
}

bool FastLocalizer::RenewAnchor(const LocalizationRequest& request) {
  if (!known_.pending->is_search) return false;
  AnchorTask task = TaskFor(request);
  task.probe_focal_ratio = known_.pending->task.probe_focal_ratio;
  if (!RenewAnchorJob(task, *job_)) return false;
  BeginAnchor(std::move(task), request, /*is_search=*/true);
  return true;
}

void FastLocalizer::BeginAnchor(AnchorTask task,
                                const LocalizationRequest& request,
                                bool is_search) {
  known_.filter.Forget(PoseFilter::kAnchorFrame);
  if (known_.HasPose()) known_.filter.Remember(PoseFilter::kAnchorFrame);
  PendingAnchor& pending = known_.pending.emplace();
  pending.task = std::move(task);
  pending.frame_index = known_.frame_index;
  pending.capture_time = request.frame->capture_time;
  pending.pyramid = request.frame->Pyramid();
  pending.is_search = is_search;
  if (known_.HasPose()) pending.velocity_s = known_.filter.velocity_s();
  known_.last_anchor_time = request.frame->capture_time;
  known_.last_anchor_frame = known_.frame_index;
  known_.bridge.reset();
}

MapMeasurement FastLocalizer::Measured(const FoundAnchor& found) const {
  MapMeasurement measured = found.pose.measured;
  measured.shared =
      SharedLandmarks(LandmarksOf(found.inliers), known_.last_anchor_landmarks);
  return measured;
}

bool FastLocalizer::WantsConfirmation(const FoundAnchor& found) const {
  if (found.is_sure || options_.is_single_frame) return false;
  // What is tentative itself confirms nothing by being where it is expected.
  return known_.is_tentative || !found.is_where_expected;
}

bool FastLocalizer::BeginsToDoubt() {
  return known_.is_tentative ||
         ++known_.contradictions >= kContradictionsToDoubt;
}

bool FastLocalizer::TakeIn(const FoundAnchor& found,
                           const MapMeasurement& measured) {
  const bool wants_confirmation = WantsConfirmation(found);
  const bool agrees =
      (!known_.is_tentative ||
       known_.filter.Confirms(PoseFilter::kAnchorFrame, measured)) &&
      known_.filter.UpdateFromMap(PoseFilter::kAnchorFrame, measured);
  if (agrees) {
    known_.contradictions = 0;
    Confirm();
    return true;
  }
  if (wants_confirmation && !BeginsToDoubt()) return false;
  known_.filter.RestartFromMap(PoseFilter::kAnchorFrame, measured);
  BeginAnew(wants_confirmation);
  return true;
}

void FastLocalizer::BeginAnew(bool wants_confirmation) {
  known_.contradictions = 0;
  if (wants_confirmation) {
    known_.is_tentative = true;
  } else if (known_.is_tentative) {
    Confirm();
  } else if (known_.HasPose()) {
    known_.camera_state.NoteJump();
  }
}

void FastLocalizer::Confirm() {
  if (!std::exchange(known_.is_tentative, false)) return;
  // Where the first pose is, or the first after kLost, the state counts.
  const auto& before = known_.camera_state.last();
  if (before && known_.filter.time() - before->time <= options_.lost_after) {
    known_.camera_state.NoteJump();
  }
}

void FastLocalizer::AdoptFinishedAnchor() {
  if (!known_.pending) return;
  if (options_.wait_for_anchor) {
    const auto delay =
        static_cast<std::uint64_t>(options_.fast.anchor_delay_frames);
    if (known_.frame_index < known_.pending->frame_index + delay) return;
    FinishAnchorJob(*job_);
  } else if (!IsFinished(*job_)) {
    return;
  }
  PendingAnchor asked = *std::exchange(known_.pending, std::nullopt);
  const SoughtAnchor sought = std::exchange(job_, nullptr)->sought;
  if (sought.lens) known_.lens_check.Add(*sought.lens);
  if (!sought.found) {
    ++(asked.is_search ? known_.failed_searches : known_.failed_refreshes);
    return;
  }
  const FoundAnchor& found = *sought.found;
  const geometry::CameraModel& camera = asked.task.request.camera;
  known_.failed_searches = 0;
  known_.failed_refreshes = 0;
  const MapMeasurement measured = Measured(found);
  const bool is_late = known_.frame_index > asked.frame_index + kLateFrames;
  if (!known_.HasPose() || !known_.filter.Remembers(PoseFilter::kAnchorFrame) ||
      (is_late && !known_.WasVerified())) {
    // Its own frame is past; what is known of the motion since, the frames that
    // were kept tell.
    StartFrom(asked, found, measured);
    asked.velocity_s = known_.filter.velocity_s();
    asked.own.clear();
  } else {
    // What odometry has gathered of error goes in one frame.
    const bool ends_odometry = known_.LeftMapAt().has_value();
    if (!TakeIn(found, measured)) {
      known_.filter.Forget(PoseFilter::kAnchorFrame);
      return;
    }
    if (ends_odometry) known_.camera_state.NoteJump();
    known_.ReturnToMap();
    MoveOwnLandmarks();
    known_.bridge.reset();
    if (is_late) {
      known_.last_anchor_landmarks = LandmarksOf(found.inliers);
      CorrectKeyFrame(camera, found, ends_odometry);
      return;
    }
    known_.filter.MakeAnchorFrameKeyFrame();
  }
  known_.last_anchor_landmarks = LandmarksOf(found.inliers);
  SetKeyFrame(asked.pyramid,
              camera,
              known_.filter.pose(PoseFilter::kKeyFrame).world_from_camera,
              asked.velocity_s,
              AsAnchored(found.inliers));
  SetOwnLandmarks(camera, asked.task.request.masks_px, std::move(asked.own));
  known_.key_frames_since_anchor = 0;
}

void FastLocalizer::StartFrom(const PendingAnchor& asked,
                              const FoundAnchor& found,
                              const MapMeasurement& measured) {
  BeginAnew(WantsConfirmation(found));
  geometry::Vector6d velocity_s = geometry::Vector6d::Zero();
  const auto& before = known_.camera_state.last();
  if (before && asked.capture_time > before->time &&
      asked.capture_time - before->time <= kMaxVelocityInterval) {
    velocity_s =
        PoseDifference(before->world_from_camera, measured.world_from_camera) /
        Seconds(asked.capture_time - before->time);
  }
  known_.filter.Start(asked.capture_time, measured, velocity_s);
  known_.filter.Remember(PoseFilter::kKeyFrame);
  const PoseEstimate pose = known_.filter.pose();
  if (!known_.is_tentative) {
    known_.camera_state.Verify(
        asked.capture_time,
        pose.world_from_camera,
        pose.covariance,
        MeanDistance(found.inliers, pose.world_from_camera.translation));
  }
  known_.where = Coasting();
  known_.own.Clear();
}

void FastLocalizer::CorrectKeyFrame(const geometry::CameraModel& camera,
                                    const FoundAnchor& found,
                                    bool ends_odometry) {
  const std::vector<std::uint32_t> anchored = LandmarksOf(found.inliers);
  std::vector<FollowedLandmark> landmarks = known_.key_frame.landmarks;
  for (FollowedLandmark& landmark : landmarks) {
    landmark.is_anchored |= std::binary_search(
        anchored.begin(), anchored.end(), landmark.match.landmark);
  }
  if (ends_odometry) {
    // The key frame has none of the map's: they lie where its pose, which is
    // now right, projects them.
    for (const LandmarkMatch& match : found.inliers) {
      landmarks.push_back({match, /*is_anchored=*/false});
    }
  }
  const int frames_since_key_frame = known_.frames_since_key_frame;
  std::vector<LandmarkMatch> own = std::move(known_.key_frame.own);
  SetKeyFrame(known_.key_frame.pyramid,
              camera,
              known_.filter.pose(PoseFilter::kKeyFrame).world_from_camera,
              known_.key_frame.velocity_s,
              std::move(landmarks));
  known_.key_frame.own = std::move(own);
  known_.frames_since_key_frame = frames_since_key_frame;
  known_.key_frames_since_anchor = 0;
  known_.filter.Forget(PoseFilter::kAnchorFrame);
}

void FastLocalizer::AddToBridge(
    const LocalizationRequest& request,
    const std::optional<Eigen::Quaterniond>& before_from_now) {
  if (!known_.bridge) {
    known_.bridge.emplace();
    known_.bridge->Begin(known_.frame_index == known_.pending->frame_index + 1);
  }
  known_.bridge->Add(*request.frame, before_from_now);
}

void FastLocalizer::CrossBridge(const LocalizationRequest& request,
                                const std::optional<GyroscopeTurn>& gyro) {
  if (!known_.bridge) return;
  const FrameBridge bridge = *std::exchange(known_.bridge, std::nullopt);
  if (!known_.HasPose()) return;
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
    const nanoseconds duration = time - known_.filter.time();
    known_.filter.Remember(PoseFilter::kLastFrame);
    known_.filter.Propagate(time);
    if (!step) return;
    known_.filter.UpdateRotation(
        PoseFilter::kLastFrame, *step, TurnSigma(duration));
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
    known_.key_frames_since_anchor = 0;
  }
  std::optional<Eigen::Quaterniond> to_now;
  if (last_turn) {
    to_now = Chain(bridge.turn_since_last_step(), *last_turn);
  }
  turn(request.frame->capture_time, to_now);
  // Of the frame before, only the pyramid is known.
  known_.filter.Forget(PoseFilter::kLastFrame);
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorNow(
    const LocalizationRequest& request) {
  DropPending();
  known_.filter.Forget(PoseFilter::kAnchorFrame);
  known_.last_anchor_time = request.frame->capture_time;
  known_.last_anchor_frame = known_.frame_index;
  const auto [found, lens] = SeekAnchor(*map_, SearchTaskFor(request));
  if (lens) known_.lens_check.Add(*lens);
  if (!found) {
    ++known_.failed_searches;
    return std::nullopt;
  }
  const MapMeasurement measured = Measured(*found);
  const bool wants_confirmation = WantsConfirmation(*found);
  const bool agrees = known_.HasPose() && known_.filter.UpdateFromMap(measured);
  if (!agrees && known_.HasPose() && wants_confirmation && !BeginsToDoubt()) {
    return std::nullopt;
  }
  known_.key_frames_since_anchor = 0;
  known_.own.Clear();
  known_.key_frame.own.clear();
  known_.last_anchor_landmarks = LandmarksOf(found->inliers);
  if (!agrees) {
    known_.filter.Start(request.frame->capture_time, measured);
    BeginAnew(wants_confirmation);
  } else {
    known_.contradictions = 0;
    if (!wants_confirmation) Confirm();
  }
  known_.where = Following();
  Followed followed;
  followed.inliers = AsAnchored(found->inliers);
  followed.num_anchored_inliers = static_cast<int>(found->inliers.size());
  followed.mean_error_px = found->pose.pose.mean_error_px;
  return followed;
}

}  // namespace groundlock::localization
