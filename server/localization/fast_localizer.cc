// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/localization/guided_matching.h"

namespace groundlock::localization {
namespace {

using std::chrono::nanoseconds;

// The acceleration of a camera whose map has no scale, relative to the spread
// of the map's cameras.
constexpr double kAccelerationOverSpread_s2 = 0.3;

// What an anchor's matches have in common (errors of the map, of the lens) is
// not in their spread: the solver's covariance is scaled by the square of the
// first and floored by the others.
constexpr double kAnchorErrorFactor = 2.0;
constexpr double kFloorOverDistance = 2e-4;  // of the mean landmark distance
constexpr double kFloor_rad = 1e-4;
// The same for the patches followed from one key frame.
constexpr double kFollowErrorFactor = 2.0;
// A followed pose that contradicts an anchor's beyond this is given up:
// chi-squared with 6 degrees of freedom exceeds it once in a million.
constexpr double kMaxMahalanobisSquared = 38.0;

// Landmarks added by projection must have been seen from a similar place.
constexpr double kMinCosFreshAngle = 0.94;  // 20 degrees
constexpr double kMaxFreshDistanceRatio = 1.5;
constexpr int kFreshViews = 6;

bool IsMasked(const std::vector<geometry::Box2>& masks_px,
              const Eigen::Vector2d& pixel_px) {
  return std::any_of(masks_px.begin(), masks_px.end(), [&](const auto& mask) {
    return mask.Contains(pixel_px);
  });
}

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

}  // namespace

struct FastLocalizer::AnchorJob {
  AnchorRequest request;
  std::uint64_t frame_index = 0;
  nanoseconds capture_time{0};
  // Where the frame path thought the camera was in that frame.
  std::optional<PoseEstimate> followed;
  // False: `followed` was only predicted; its covariance is an older frame's.
  bool is_tracked = false;
  // Written by the background task, read once `done` is ready. It gives the
  // pyramid derivatives.
  std::optional<Anchor> anchor;
  std::shared_ptr<const image::LumaPyramid> pyramid;
  std::future<void> done;
};

namespace {

CameraMotionOptions MotionOptionsFor(const map::Map& map) {
  CameraMotionOptions options;
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
      motion_(MotionOptionsFor(*map_)) {}

FastLocalizer::~FastLocalizer() = default;

void FastLocalizer::Reset() {
  pose_.reset();
  state_.Reset();
  key_frame_ = {};
  pending_.reset();
}

absl::StatusOr<LocalizationResult> FastLocalizer::Localize(
    const LocalizationRequest& request) {
  RETURN_IF_ERROR(ValidateRequest(request));
  const image::Frame& frame = *request.frame;
  ++frame_index_;

  std::optional<geometry::Rigid3> predicted;
  if (pose_) predicted = motion_.PredictPose(frame.capture_time);
  if (const auto job = TakeFinishedAnchor(frame_index_)) {
    predicted = Adopt(*job, frame.capture_time);
  }
  std::optional<Followed> followed;
  // A sender may change its resolution; then only descriptors match.
  if (predicted && !key_frame_.landmarks.empty() &&
      key_frame_.pyramid->size_px == frame.size_px()) {
    const auto pyramid = frame.Pyramid();
    followed = Follow(request, *pyramid, *predicted);
    if (followed &&
        !IsVerified(*followed, request.camera, fast_options_.min_inliers)) {
      followed.reset();
    }
  }
  bool anchored = false;
  if (!followed) {
    if (options_.wait_for_anchor || !run_in_background_) {
      followed = AnchorNow(request);
      anchored = followed.has_value();
    } else if (!pending_) {
      StartAnchor(request, /*is_tracked=*/false);
    }
  }
  if (!followed) return UnverifiedResult(frame.capture_time);

  UpdateMotion(*followed, frame.capture_time);
  LocalizationResult result = TrackedResult(*followed, frame.capture_time);
  ++frames_since_key_frame_;
  const auto num_inliers = static_cast<std::size_t>(followed->pose.num_inliers);
  if (anchored ||
      frames_since_key_frame_ >= fast_options_.max_frames_per_key_frame ||
      num_inliers < key_frame_landmarks_ * 7 / 10) {
    MakeKeyFrame(request, *followed);
  }
  const bool drifting =
      (key_frames_since_anchor_ >= fast_options_.max_key_frames_per_anchor ||
       followed->num_anchored_inliers < fast_options_.healthy_inliers) &&
      frame_index_ >=
          last_anchor_frame_ + static_cast<std::uint64_t>(
                                   fast_options_.min_frames_between_anchors);
  const nanoseconds since_anchor = frame.capture_time - last_anchor_time_;
  if (!pending_ && (drifting || since_anchor >= fast_options_.anchor_period)) {
    StartAnchor(request, /*is_tracked=*/true);
  }
  return result;
}

void FastLocalizer::StartAnchor(const LocalizationRequest& request,
                                bool is_tracked) {
  auto job = std::make_shared<AnchorJob>();
  job->request.luma = request.frame->luma;
  job->pyramid = request.frame->Pyramid();
  job->request.camera = request.camera;
  job->request.masks_px = request.masks_px;
  job->request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  job->frame_index = frame_index_;
  job->capture_time = request.frame->capture_time;
  if (pose_) {
    job->followed = {motion_.PredictPose(job->capture_time), pose_->covariance};
    job->request.prior_world_from_camera = job->followed->world_from_camera;
    job->is_tracked = is_tracked;
  }
  last_anchor_time_ = job->capture_time;
  last_anchor_frame_ = frame_index_;
  pending_ = job;
  AnchorOptions anchor_options;
  anchor_options.min_landmark_views = options_.min_landmark_views;
  anchor_options.sift_contrast_threshold = options_.sift_contrast_threshold;
  // The task alone holds the promise: if it is dropped unrun (a pool that shuts
  // down), the promise breaks and nobody waits for it forever.
  auto promise = std::make_shared<std::promise<void>>();
  job->done = promise->get_future();
  auto task = [job, promise = std::move(promise), map = map_, anchor_options] {
    job->anchor = FindAnchor(*map, job->request, anchor_options);
    if (job->anchor) {
      job->pyramid = image::WithDerivatives(job->pyramid);
    }
    job->request.luma.release();
    promise->set_value();
  };
  if (run_in_background_) {
    run_in_background_(std::move(task));
  } else {
    task();
  }
}

std::shared_ptr<FastLocalizer::AnchorJob> FastLocalizer::TakeFinishedAnchor(
    std::uint64_t frame_index) {
  if (!pending_) return nullptr;
  if (options_.wait_for_anchor) {
    const auto delay =
        static_cast<std::uint64_t>(fast_options_.anchor_delay_frames);
    if (frame_index < pending_->frame_index + delay) return nullptr;
    pending_->done.wait();
  } else if (pending_->done.wait_for(std::chrono::seconds(0)) !=
             std::future_status::ready) {
    return nullptr;
  }
  const auto job = std::exchange(pending_, nullptr);
  return job->anchor ? job : nullptr;
}

geometry::Rigid3 FastLocalizer::Adopt(const AnchorJob& job, nanoseconds now) {
  PoseEstimate pose{job.anchor->pose.world_from_camera,
                    AnchorCovariance(*job.anchor)};
  const bool is_followed = pose_ && job.followed;
  if (is_followed && job.is_tracked) {
    pose = FusePoses(*job.followed, pose, kMaxMahalanobisSquared);
  }
  SetKeyFrame(
      job.pyramid, job.request.camera, pose, AsAnchored(job.anchor->inliers));
  key_frames_since_anchor_ = 0;
  if (!is_followed) {
    motion_.Start(job.capture_time, pose);
    motion_.MakeReference();
    pose_ = pose;
    return pose.world_from_camera;
  }
  // The camera's own motion since the anchor's frame, put after the anchor.
  motion_.Shift(pose.world_from_camera *
                job.followed->world_from_camera.Inverse());
  return motion_.PredictPose(now);
}

geometry::Matrix6d FastLocalizer::AnchorCovariance(const Anchor& anchor) const {
  const double depth = MeanDistance(
      *map_, anchor.inliers, anchor.pose.world_from_camera.translation);
  geometry::Matrix6d covariance =
      kAnchorErrorFactor * kAnchorErrorFactor * anchor.pose.covariance;
  covariance.diagonal().head<3>().array() +=
      std::pow(kFloorOverDistance * depth, 2);
  covariance.diagonal().tail<3>().array() += std::pow(kFloor_rad, 2);
  return covariance;
}

void FastLocalizer::SetKeyFrame(
    std::shared_ptr<const image::LumaPyramid> pyramid,
    const geometry::CameraModel& camera,
    const PoseEstimate& pose,
    std::vector<FollowedLandmark> landmarks) {
  const geometry::Rigid3 camera_from_world = pose.world_from_camera.Inverse();
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
  key_frame_pose_ = pose;
  key_frame_landmarks_ = key_frame_.landmarks.size();
  frames_since_key_frame_ = 0;
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorNow(
    const LocalizationRequest& request) {
  AnchorRequest anchor_request;
  anchor_request.luma = request.frame->luma;
  anchor_request.camera = request.camera;
  anchor_request.masks_px = request.masks_px;
  anchor_request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  if (pose_) {
    anchor_request.prior_world_from_camera =
        motion_.PredictPose(request.frame->capture_time);
  }
  AnchorOptions anchor_options;
  anchor_options.min_landmark_views = options_.min_landmark_views;
  anchor_options.sift_contrast_threshold = options_.sift_contrast_threshold;
  auto anchor = FindAnchor(*map_, anchor_request, anchor_options);
  pending_.reset();
  last_anchor_time_ = request.frame->capture_time;
  last_anchor_frame_ = frame_index_;
  if (!anchor) return std::nullopt;
  key_frames_since_anchor_ = 0;
  Followed followed;
  followed.landmarks = AsAnchored(anchor->inliers);
  followed.num_anchored_inliers = anchor->pose.num_inliers;
  followed.anchor = {anchor->pose.world_from_camera, AnchorCovariance(*anchor)};
  followed.pose = std::move(anchor->pose);
  followed.pose.is_inlier.assign(followed.landmarks.size(), 1);
  return followed;
}

std::optional<FastLocalizer::Followed> FastLocalizer::Follow(
    const LocalizationRequest& request,
    const image::LumaPyramid& pyramid,
    const geometry::Rigid3& predicted) const {
  Followed followed;
  followed.landmarks =
      FollowLandmarks(*map_, key_frame_, pyramid, request.camera, predicted);
  std::erase_if(followed.landmarks, [&](const FollowedLandmark& landmark) {
    return IsMasked(request.masks_px, landmark.match.pixel_px);
  });
  std::vector<PoseObservation> observations;
  observations.reserve(followed.landmarks.size());
  for (const FollowedLandmark& landmark : followed.landmarks) {
    observations.push_back(
        {map_->landmarks()[landmark.match.landmark].Position(),
         landmark.match.pixel_px,
         1.0});
  }
  auto pose = RefinePoseRobustly(
      request.camera, observations, predicted, RobustPoseOptions());
  if (!pose) return std::nullopt;
  followed.pose = *std::move(pose);
  followed.relative_covariance =
      kFollowErrorFactor * kFollowErrorFactor * followed.pose.covariance;
  for (const FollowedLandmark& landmark : InliersOf(followed)) {
    followed.num_anchored_inliers += landmark.is_anchored ? 1 : 0;
  }
  return followed;
}

std::vector<FollowedLandmark> FastLocalizer::InliersOf(
    const Followed& followed) {
  std::vector<FollowedLandmark> inliers;
  for (std::size_t i = 0; i < followed.landmarks.size(); ++i) {
    if (followed.pose.is_inlier[i] != 0) {
      inliers.push_back(followed.landmarks[i]);
    }
  }
  return inliers;
}

bool FastLocalizer::IsVerified(const Followed& followed,
                               const geometry::CameraModel& camera,
                               int min_inliers) const {
  if (followed.pose.num_inliers < min_inliers) return false;
  if (followed.pose.num_inliers <
      fast_options_.min_inlier_share *
          static_cast<double>(followed.landmarks.size())) {
    return false;
  }
  return CountOccupiedCells(MatchesOf(InliersOf(followed)), camera) >=
         fast_options_.min_cells;
}

void FastLocalizer::UpdateMotion(const Followed& followed,
                                 nanoseconds capture_time) {
  if (followed.anchor) {
    pose_ = followed.anchor;
    motion_.Start(capture_time, *pose_);
    return;
  }
  const PoseEstimate relative = motion_.Update(
      capture_time,
      {followed.pose.world_from_camera, followed.relative_covariance});
  pose_ = {relative.world_from_camera,
           TransportCovariance(key_frame_pose_,
                               relative.world_from_camera.translation) +
               relative.covariance};
}

void FastLocalizer::MakeKeyFrame(const LocalizationRequest& request,
                                 const Followed& followed) {
  ++key_frames_since_anchor_;
  std::vector<FollowedLandmark> landmarks = InliersOf(followed);
  if (followed.num_anchored_inliers < fast_options_.healthy_inliers) {
    const auto fresh =
        ProjectFreshLandmarks(request, pose_->world_from_camera, landmarks);
    landmarks.insert(landmarks.end(), fresh.begin(), fresh.end());
  }
  SetKeyFrame(image::WithDerivatives(request.frame->Pyramid()),
              request.camera,
              *pose_,
              std::move(landmarks));
  motion_.MakeReference();
}

std::vector<FollowedLandmark> FastLocalizer::ProjectFreshLandmarks(
    const LocalizationRequest& request,
    const geometry::Rigid3& world_from_camera,
    const std::vector<FollowedLandmark>& known) const {
  std::unordered_set<std::uint32_t> seen;
  for (const FollowedLandmark& landmark : known) {
    seen.insert(landmark.match.landmark);
  }
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<FollowedLandmark> fresh;
  for (const std::size_t index :
       NearbyViews(*map_, world_from_camera, kFreshViews)) {
    const map::MapView& view = map_->view(index);
    for (const map::Feature& feature : map_->FeaturesOf(view)) {
      const map::Landmark& landmark = map_->landmarks()[feature.landmark];
      if (static_cast<int>(landmark.num_observations) <
              options_.min_landmark_views ||
          !seen.insert(feature.landmark).second) {
        continue;
      }
      const Eigen::Vector3d from_camera =
          landmark.Position() - world_from_camera.translation;
      const Eigen::Vector3d from_view = landmark.Position() - view.center_world;
      const double ratio = from_camera.norm() / from_view.norm();
      const double cos_angle =
          from_camera.dot(from_view) / (from_camera.norm() * from_view.norm());
      if (cos_angle < kMinCosFreshAngle || ratio > kMaxFreshDistanceRatio ||
          ratio < 1.0 / kMaxFreshDistanceRatio) {
        continue;
      }
      const auto pixel = request.camera.ImageFromCamera(camera_from_world *
                                                        landmark.Position());
      if (!pixel || !request.camera.IsInsideImage(*pixel, 8.0) ||
          IsMasked(request.masks_px, *pixel)) {
        continue;
      }
      fresh.push_back({{feature.landmark, *pixel}, /*is_anchored=*/false});
    }
  }
  const int room =
      fast_options_.max_followed_landmarks - static_cast<int>(known.size());
  return SpreadOverImage(
      *map_, fresh, request.frame->luma.size(), std::max(0, room));
}

LocalizationResult FastLocalizer::TrackedResult(const Followed& followed,
                                                nanoseconds capture_time) {
  LocalizationResult result;
  result.num_inliers = followed.pose.num_inliers;
  result.mean_reprojection_error_px = followed.pose.rms_error_px;
  result.inliers = MatchesOf(InliersOf(followed));
  const geometry::Rigid3& world_from_camera = pose_->world_from_camera;
  const double depth =
      MeanDistance(*map_, result.inliers, world_from_camera.translation);
  state_.Succeed(
      capture_time, world_from_camera, pose_->covariance, depth, result);
  return result;
}

LocalizationResult FastLocalizer::UnverifiedResult(nanoseconds capture_time) {
  LocalizationResult result;
  state_.Fail(capture_time, result);
  if (result.state != CameraState::kHeld) {
    pose_.reset();
    key_frame_ = {};
  }
  return result;
}

}  // namespace groundlock::localization
