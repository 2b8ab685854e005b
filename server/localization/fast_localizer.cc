// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/localization/fresh_landmarks.h"
#include "server/localization/rotation_flow.h"

namespace groundlock::localization {
namespace {

using std::chrono::nanoseconds;

// The acceleration of a camera whose map has no scale, relative to the spread
// of the map's cameras.
constexpr double kAccelerationOverSpread_s2 = 0.3;
// An anchor later than this corrects the key frame instead of replacing it.
constexpr std::uint64_t kLateFrames = 8;
// Frames that are kept while an anchor is under way and none is verified; when
// there are so many, every second of them goes.
constexpr std::size_t kMaxBridgeFrames = 24;
// Patches followed from one key frame err in common, and alike in many frames.
constexpr double kFollowErrorFactor = 1.5;
// Of a rotation by image corners, for what translation does to near ones.
constexpr double kMinFlowSigma_rad = 2e-3;

double MeanDistance(const map::Map& map,
                    const std::vector<LandmarkMatch>& matches,
                    const Eigen::Vector3d& center_world) {
  double sum = 0.0;
  for (const LandmarkMatch& match : matches) {
    sum += (map.landmarks()[match.landmark].Position() - center_world).norm();
  }
  return matches.empty() ? 1.0 : sum / static_cast<double>(matches.size());
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

std::vector<LandmarkMatch> MatchesOf(
    const std::vector<FollowedLandmark>& landmarks) {
  std::vector<LandmarkMatch> matches;
  matches.reserve(landmarks.size());
  for (const FollowedLandmark& landmark : landmarks) {
    matches.push_back(landmark.match);
  }
  return matches;
}

PoseFilterOptions MotionOptionsFor(const map::Map& map) {
  PoseFilterOptions options;
  if (map.info().metric || map.num_views() == 0) return options;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    mean += map.view(i).center_world;
  }
  mean /= static_cast<double>(map.num_views());
  double spread = 0.0;
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    spread += (map.view(i).center_world - mean).norm();
  }
  spread /= static_cast<double>(map.num_views());
  options.acceleration_s2 = std::max(1e-9, kAccelerationOverSpread_s2 * spread);
  options.initial_velocity_s = options.acceleration_s2;
  return options;
}

}  // namespace

FastLocalizer::FastLocalizer(std::shared_ptr<const map::Map> map,
                             const LocalizerOptions& options,
                             const FastLocalizerOptions& fast_options,
                             BackgroundRunner run_in_background)
    : map_(std::move(map)),
      options_(options),
      fast_options_(fast_options),
      run_in_background_(std::move(run_in_background)),
      state_(options.lost_after, HoldModel()),
      filter_(MotionOptionsFor(*map_)) {}

FastLocalizer::~FastLocalizer() = default;

void FastLocalizer::Reset() {
  has_pose_ = false;
  state_.Reset();
  key_frame_ = {};
  exposure_ = {};
  last_pyramid_.reset();
  pending_.reset();
}

absl::StatusOr<LocalizationResult> FastLocalizer::Localize(
    const LocalizationRequest& given) {
  RETURN_IF_ERROR(ValidateRequest(given));
  LocalizationRequest request = given;
  if (given.prior) {
    ASSIGN_OR_RETURN(request.prior, PlaceInWorld(*map_, *given.prior));
  }
  const nanoseconds now = request.frame->capture_time;
  ++frame_index_;

  AdoptFinishedAnchor();
  if (pending_ == nullptr) CrossBridge(request);
  std::optional<Followed> followed;
  if (has_pose_) {
    filter_.Propagate(now);
    followed = Follow(request);
    if (!followed) BridgeRotation(request);
  }
  bool anchored = false;
  if (!followed) {
    if (options_.wait_for_anchor || !run_in_background_) {
      followed = AnchorNow(request);
      anchored = followed.has_value();
    } else if (!pending_) {
      StartAnchor(request);
    } else {
      AddToBridge(request);
    }
  }
  is_following_ = followed.has_value();
  LocalizationResult result;
  if (followed) {
    result = TrackedResult(*followed, now);
    KeepUp(request, *followed, anchored);
  } else {
    result = UnverifiedResult(now);
  }
  last_pyramid_ = has_pose_ ? request.frame->Pyramid() : nullptr;
  filter_.Remember(PoseFilter::kLastFrame);
  return result;
}

void FastLocalizer::KeepUp(const LocalizationRequest& request,
                           const Followed& followed,
                           bool anchored) {
  ++frames_since_key_frame_;
  if (anchored ||
      frames_since_key_frame_ >= fast_options_.max_frames_per_key_frame ||
      followed.inliers.size() < key_frame_landmarks_ * 7 / 10) {
    MakeKeyFrame(request, followed);
  }
  const bool drifting =
      (key_frames_since_anchor_ >= fast_options_.max_key_frames_per_anchor ||
       followed.num_anchored_inliers < fast_options_.healthy_inliers) &&
      frame_index_ >=
          last_anchor_frame_ + static_cast<std::uint64_t>(
                                   fast_options_.min_frames_between_anchors);
  const nanoseconds since_anchor =
      request.frame->capture_time - last_anchor_time_;
  if (!pending_ && (drifting || since_anchor >= fast_options_.anchor_period)) {
    StartAnchor(request);
  }
}

AnchorTask FastLocalizer::TaskFor(const LocalizationRequest& request) const {
  AnchorTask task;
  task.request.luma = request.frame->luma;
  task.request.camera = request.camera;
  task.request.masks_px = request.masks_px;
  task.request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  task.request.prior = request.prior;
  if (has_pose_) {
    task.request.prior_world_from_camera = filter_.pose().world_from_camera;
  }
  task.options.min_landmark_views = options_.min_landmark_views;
  task.options.sift_contrast_threshold = options_.sift_contrast_threshold;
  task.options.max_features =
      std::min(task.options.max_features, options_.max_features);
  return task;
}

void FastLocalizer::StartAnchor(const LocalizationRequest& request) {
  filter_.Forget(PoseFilter::kAnchorFrame);
  if (has_pose_) filter_.Remember(PoseFilter::kAnchorFrame);
  pending_velocity_s_.setZero();
  if (has_pose_) pending_velocity_s_ = filter_.velocity_s();
  last_anchor_time_ = request.frame->capture_time;
  last_anchor_frame_ = frame_index_;
  bridge_.clear();
  bridge_stride_ = 1;
  pending_ = StartAnchorJob(
      map_, TaskFor(request), *request.frame, frame_index_, run_in_background_);
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
    pending_->done.wait();
  } else if (pending_->done.wait_for(std::chrono::seconds(0)) !=
             std::future_status::ready) {
    return;
  }
  const auto job = std::exchange(pending_, nullptr);
  if (!job->found) return;
  const MapMeasurement measured = Measured(*job->found);
  const bool is_late = frame_index_ > job->frame_index + kLateFrames;
  if (!has_pose_ || !filter_.Remembers(PoseFilter::kAnchorFrame) ||
      (is_late && !is_following_)) {
    // Its own frame is past; at rest since, as far as is known, unless the
    // frames that were kept since say more.
    if (has_pose_) state_.NoteJump();
    filter_.Start(job->capture_time, measured);
    filter_.Remember(PoseFilter::kKeyFrame);
    has_pose_ = true;
  } else {
    if (!filter_.UpdateFromMap(PoseFilter::kAnchorFrame, measured)) {
      filter_.RestartFromMap(PoseFilter::kAnchorFrame, measured);
      state_.NoteJump();
    }
    bridge_.clear();
    if (is_late) {
      CorrectKeyFrame(*job);
      return;
    }
    filter_.MakeAnchorFrameKeyFrame();
  }
  SetKeyFrame(job->pyramid,
              job->camera,
              filter_.pose(PoseFilter::kKeyFrame).world_from_camera,
              pending_velocity_s_,
              AsAnchored(job->found->inliers));
  key_frames_since_anchor_ = 0;
}

void FastLocalizer::CorrectKeyFrame(const AnchorJob& job) {
  const std::vector<std::uint32_t> anchored = LandmarksOf(job.found->inliers);
  std::vector<FollowedLandmark> landmarks = key_frame_.landmarks;
  for (FollowedLandmark& landmark : landmarks) {
    landmark.is_anchored |= std::binary_search(
        anchored.begin(), anchored.end(), landmark.match.landmark);
  }
  const int frames_since_key_frame = frames_since_key_frame_;
  SetKeyFrame(key_frame_.pyramid,
              job.camera,
              filter_.pose(PoseFilter::kKeyFrame).world_from_camera,
              key_frame_.velocity_s,
              std::move(landmarks));
  frames_since_key_frame_ = frames_since_key_frame;
  key_frames_since_anchor_ = 0;
  filter_.Forget(PoseFilter::kAnchorFrame);
}

void FastLocalizer::AddToBridge(const LocalizationRequest& request) {
  if ((frame_index_ - pending_->frame_index) % bridge_stride_ != 0) return;
  bridge_.push_back({frame_index_, *request.frame});
  // The pyramid alone is looked at; its first level is the luma.
  image::Frame& kept = bridge_.back().frame;
  kept.colour.reset();
  kept.luma = kept.Pyramid()->levels.front();
  if (bridge_.size() < kMaxBridgeFrames) return;
  bridge_stride_ *= 2;
  std::erase_if(bridge_, [&](const BridgeFrame& old) {
    return (old.frame_index - pending_->frame_index) % bridge_stride_ != 0;
  });
}

void FastLocalizer::CrossBridge(const LocalizationRequest& request) {
  const std::vector<BridgeFrame> bridge = std::exchange(bridge_, {});
  if (!has_pose_) return;
  LocalizationRequest past = request;
  past.prior.reset();
  for (const BridgeFrame& kept : bridge) {
    past.frame = &kept.frame;
    filter_.Propagate(kept.frame.capture_time);
    const auto followed = Follow(past);
    if (!followed) return;
    MakeKeyFrame(past, *followed);
    key_frames_since_anchor_ = 0;
  }
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorNow(
    const LocalizationRequest& request) {
  pending_.reset();
  filter_.Forget(PoseFilter::kAnchorFrame);
  last_anchor_time_ = request.frame->capture_time;
  last_anchor_frame_ = frame_index_;
  const auto found = SeekAnchor(*map_, TaskFor(request));
  if (!found) return std::nullopt;
  key_frames_since_anchor_ = 0;
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

std::optional<FastLocalizer::Followed> FastLocalizer::Follow(
    const LocalizationRequest& request) {
  // A sender may change its resolution; then only descriptors match.
  if (key_frame_.landmarks.empty() ||
      key_frame_.pyramid->size_px != request.frame->size_px()) {
    return std::nullopt;
  }
  // As seen from the pose by which the key frame's landmarks were projected.
  MovingCamera predicted;
  predicted.world_from_camera =
      key_frame_.world_from_camera *
      filter_.pose(PoseFilter::kKeyFrame).world_from_camera.Inverse() *
      filter_.pose().world_from_camera;
  predicted.velocity_s = filter_.velocity_s();
  predicted.exposure_s = exposure_.seconds();
  std::vector<FollowedLandmark> landmarks = FollowLandmarks(
      *map_, key_frame_, *request.frame->Pyramid(), request.camera, predicted);
  std::erase_if(landmarks, [&](const FollowedLandmark& landmark) {
    return std::any_of(request.masks_px.begin(),
                       request.masks_px.end(),
                       [&](const geometry::Box2& mask) {
                         return mask.Contains(landmark.match.pixel_px);
                       });
  });
  std::vector<PoseObservation> observations;
  observations.reserve(landmarks.size());
  for (const FollowedLandmark& landmark : landmarks) {
    observations.push_back(
        {map_->landmarks()[landmark.match.landmark].Position(),
         landmark.match.pixel_px,
         1.0});
  }
  const auto pose = RefinePoseRobustly(request.camera,
                                       observations,
                                       predicted.world_from_camera,
                                       RobustPoseOptions());
  if (!pose) return std::nullopt;
  Followed followed;
  followed.mean_error_px = pose->mean_error_px;
  for (std::size_t i = 0; i < landmarks.size(); ++i) {
    if (pose->is_inlier[i] == 0) continue;
    followed.inliers.push_back(landmarks[i]);
    followed.num_anchored_inliers += landmarks[i].is_anchored ? 1 : 0;
  }
  if (pose->num_inliers < fast_options_.min_inliers ||
      pose->num_inliers < fast_options_.min_inlier_share *
                              static_cast<double>(landmarks.size()) ||
      CountOccupiedCells(MatchesOf(followed.inliers), request.camera) <
          fast_options_.min_cells) {
    return std::nullopt;
  }
  if (!filter_.UpdateRelative(
          PoseFilter::kKeyFrame,
          key_frame_.world_from_camera,
          {pose->world_from_camera,
           kFollowErrorFactor * kFollowErrorFactor * pose->covariance})) {
    return std::nullopt;
  }
  ObserveExposure(*map_,
                  key_frame_,
                  *request.frame->Pyramid(),
                  request.camera,
                  {pose->world_from_camera, filter_.velocity_s()},
                  followed.inliers,
                  exposure_);
  return followed;
}

void FastLocalizer::BridgeRotation(const LocalizationRequest& request) {
  if (last_pyramid_ == nullptr || !filter_.Remembers(PoseFilter::kLastFrame)) {
    return;
  }
  const auto flow =
      EstimateRotation(*last_pyramid_,
                       *request.frame->Pyramid(),
                       request.camera,
                       request.masks_px,
                       filter_.pose(PoseFilter::kLastFrame)
                               .world_from_camera.rotation.conjugate() *
                           filter_.pose().world_from_camera.rotation,
                       base::MixSeed(options_.seed, request.frame->sequence));
  if (!flow) return;
  filter_.UpdateRotation(PoseFilter::kLastFrame,
                         flow->before_from_now,
                         std::max(kMinFlowSigma_rad, flow->rms_error_rad));
}

void FastLocalizer::SetKeyFrame(
    std::shared_ptr<const image::LumaPyramid> pyramid,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const geometry::Vector6d& velocity_s,
    std::vector<FollowedLandmark> landmarks) {
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::erase_if(landmarks, [&](FollowedLandmark& landmark) {
    const auto pixel = camera.ImageFromCamera(
        camera_from_world *
        map_->landmarks()[landmark.match.landmark].Position());
    if (pixel) landmark.match.pixel_px = *pixel;
    return !pixel || !camera.IsInsideImage(*pixel);
  });
  key_frame_.landmarks = SpreadOverImage(
      *map_, landmarks, pyramid->size_px, fast_options_.max_followed_landmarks);
  key_frame_.pyramid = std::move(pyramid);
  key_frame_.world_from_camera = world_from_camera;
  key_frame_.velocity_s = velocity_s;
  key_frame_landmarks_ = key_frame_.landmarks.size();
  frames_since_key_frame_ = 0;
}

void FastLocalizer::MakeKeyFrame(const LocalizationRequest& request,
                                 const Followed& followed) {
  ++key_frames_since_anchor_;
  filter_.Remember(PoseFilter::kKeyFrame);
  const geometry::Rigid3 world_from_camera = filter_.pose().world_from_camera;
  std::vector<FollowedLandmark> landmarks = followed.inliers;
  if (followed.num_anchored_inliers < fast_options_.full_inliers) {
    const auto fresh =
        ProjectFreshLandmarks(*map_,
                              request.camera,
                              world_from_camera,
                              request.masks_px,
                              landmarks,
                              options_.min_landmark_views,
                              fast_options_.max_followed_landmarks -
                                  static_cast<int>(landmarks.size()));
    landmarks.insert(landmarks.end(), fresh.begin(), fresh.end());
  }
  SetKeyFrame(image::WithDerivatives(request.frame->Pyramid()),
              request.camera,
              world_from_camera,
              filter_.velocity_s(),
              std::move(landmarks));
}

LocalizationResult FastLocalizer::TrackedResult(const Followed& followed,
                                                nanoseconds capture_time) {
  LocalizationResult result;
  result.num_inliers = static_cast<int>(followed.inliers.size());
  result.mean_reprojection_error_px = followed.mean_error_px;
  result.inliers = MatchesOf(followed.inliers);
  const PoseEstimate pose = filter_.pose();
  const double depth =
      MeanDistance(*map_, result.inliers, pose.world_from_camera.translation);
  state_.Succeed(
      capture_time, pose.world_from_camera, pose.covariance, depth, result);
  return result;
}

LocalizationResult FastLocalizer::UnverifiedResult(nanoseconds capture_time) {
  LocalizationResult result;
  std::optional<PoseEstimate> bridged;
  if (has_pose_) bridged = filter_.pose();
  state_.Fail(capture_time, bridged, result);
  if (result.state != CameraState::kHeld) {
    has_pose_ = false;
    key_frame_ = {};
  }
  return result;
}

}  // namespace groundlock::localization
