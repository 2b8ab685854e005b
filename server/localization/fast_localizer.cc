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

double Seconds(nanoseconds t) {
  return std::chrono::duration<double>(t).count();
}

// Prediction beyond this leaves the camera where it is: a hand or a drone does
// not go on turning.
constexpr double kMaxPrediction_s = 0.25;
// Weight of the newest step in the smoothed velocity.
constexpr double kVelocityGain = 0.6;

// What neighbouring observations have in common (map error, an anchor's SIFT
// noise) is not in the residuals' spread: the solver's covariance is scaled by
// the square of the first and floored by the others.
constexpr double kCommonErrorFactor = 3.0;
constexpr double kFloorOverDistance = 2e-4;  // of the mean landmark distance
constexpr double kFloor_rad = 1e-4;

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

}  // namespace

struct FastLocalizer::AnchorJob {
  AnchorRequest request;
  std::uint64_t frame_index = 0;
  nanoseconds capture_time{0};
  // Where the frame path thought the camera was in that frame.
  std::optional<geometry::Rigid3> followed_world_from_camera;
  // Written by the background task, read once `done` is ready.
  std::optional<Anchor> anchor;
  std::shared_ptr<const LumaPyramid> pyramid;
  std::promise<void> promise;
  std::future<void> done = promise.get_future();
};

geometry::Rigid3 FastLocalizer::Motion::Predict(nanoseconds time) const {
  const double dt =
      std::clamp(Seconds(time - capture_time), 0.0, kMaxPrediction_s);
  return {(geometry::QuaternionFromRotationVector(
               dt * angular_velocity_world_rad_s) *
           world_from_camera.rotation)
              .normalized(),
          world_from_camera.translation + dt * velocity_world_s};
}

FastLocalizer::FastLocalizer(std::shared_ptr<const map::Map> map,
                             const LocalizerOptions& options,
                             const FastLocalizerOptions& fast_options,
                             BackgroundRunner run_in_background)
    : map_(std::move(map)),
      options_(options),
      fast_options_(fast_options),
      run_in_background_(std::move(run_in_background)),
      state_(options.lost_after, HoldModel()) {}

FastLocalizer::~FastLocalizer() = default;

void FastLocalizer::Reset() {
  motion_.reset();
  state_.Reset();
  key_frame_ = {};
  pending_.reset();
}

absl::StatusOr<LocalizationResult> FastLocalizer::Localize(
    const LocalizationRequest& request) {
  const image::Frame& frame = *request.frame;
  RETURN_IF_ERROR(ValidateRequest(request));
  ++frame_index_;

  std::optional<geometry::Rigid3> predicted;
  if (motion_) predicted = motion_->Predict(frame.capture_time);
  if (const auto job = TakeFinishedAnchor(frame_index_)) {
    predicted = Adopt(*job, frame.capture_time);
  }
  std::optional<Followed> followed;
  if (predicted && !key_frame_.landmarks.empty()) {
    const auto pyramid = BuildPyramid(frame.luma, /*with_derivatives=*/false);
    followed = Follow(request, *pyramid, *predicted);
    if (followed &&
        !IsVerified(*followed, request.camera, fast_options_.min_inliers)) {
      followed.reset();
    }
  }
  bool anchored = false;
  if (!followed && (options_.wait_for_anchor || !run_in_background_)) {
    followed = AnchorNow(request);
    anchored = followed.has_value();
  }
  if (!followed) {
    if (!pending_) StartAnchor(request);
    return UnverifiedResult(frame.capture_time);
  }

  UpdateMotion(followed->pose, frame.capture_time);
  LocalizationResult result = TrackedResult(*followed, frame.capture_time);
  ++frames_since_key_frame_;
  const auto num_inliers = static_cast<std::size_t>(followed->pose.num_inliers);
  if (anchored ||
      frames_since_key_frame_ >= fast_options_.max_frames_per_key_frame ||
      num_inliers < key_frame_landmarks_ * 7 / 10) {
    MakeKeyFrame(request, *followed);
  }
  const bool weak = followed->pose.num_inliers < fast_options_.healthy_inliers;
  const nanoseconds since_anchor = frame.capture_time - last_anchor_time_;
  if (!pending_ &&
      (since_anchor >= fast_options_.anchor_period ||
       (weak && since_anchor * 4 >= fast_options_.anchor_period))) {
    StartAnchor(request);
  }
  return result;
}

void FastLocalizer::StartAnchor(const LocalizationRequest& request) {
  auto job = std::make_shared<AnchorJob>();
  job->request.luma = request.frame->luma;
  job->request.camera = request.camera;
  job->request.masks_px = request.masks_px;
  job->request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  job->frame_index = frame_index_;
  job->capture_time = request.frame->capture_time;
  if (motion_) {
    job->followed_world_from_camera = motion_->Predict(job->capture_time);
    job->request.prior_world_from_camera = job->followed_world_from_camera;
  }
  last_anchor_time_ = job->capture_time;
  pending_ = job;
  AnchorOptions anchor_options;
  anchor_options.min_landmark_views = options_.min_landmark_views;
  anchor_options.sift_contrast_threshold = options_.sift_contrast_threshold;
  auto task = [job, map = map_, anchor_options] {
    job->anchor = FindAnchor(*map, job->request, anchor_options);
    if (job->anchor) {
      job->pyramid = BuildPyramid(job->request.luma, /*with_derivatives=*/true);
    }
    job->request.luma.release();
    job->promise.set_value();
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
  const Anchor& anchor = *job.anchor;
  key_frame_.pyramid = job.pyramid;
  key_frame_.landmarks = SpreadOverImage(*map_,
                                         anchor.inliers,
                                         job.pyramid->size_px,
                                         fast_options_.max_followed_landmarks);
  key_frame_landmarks_ = key_frame_.landmarks.size();
  frames_since_key_frame_ = 0;
  const geometry::Rigid3& anchored = anchor.pose.world_from_camera;
  if (!motion_ || !job.followed_world_from_camera) {
    Motion motion;
    motion.world_from_camera = anchored;
    motion.capture_time = job.capture_time;
    motion_ = motion;
    return anchored;
  }
  // The camera's own motion since the anchor's frame, put after the anchor.
  const geometry::Rigid3 moved =
      job.followed_world_from_camera->Inverse() * motion_->Predict(now);
  return anchored * moved;
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorNow(
    const LocalizationRequest& request) {
  AnchorRequest anchor_request;
  anchor_request.luma = request.frame->luma;
  anchor_request.camera = request.camera;
  anchor_request.masks_px = request.masks_px;
  anchor_request.seed = base::MixSeed(options_.seed, request.frame->sequence);
  if (motion_) {
    anchor_request.prior_world_from_camera =
        motion_->Predict(request.frame->capture_time);
  }
  AnchorOptions anchor_options;
  anchor_options.min_landmark_views = options_.min_landmark_views;
  anchor_options.sift_contrast_threshold = options_.sift_contrast_threshold;
  auto anchor = FindAnchor(*map_, anchor_request, anchor_options);
  pending_.reset();
  last_anchor_time_ = request.frame->capture_time;
  if (!anchor) return std::nullopt;
  Followed followed;
  followed.matches = std::move(anchor->inliers);
  followed.pose = std::move(anchor->pose);
  followed.pose.is_inlier.assign(followed.matches.size(), 1);
  return followed;
}

std::optional<FastLocalizer::Followed> FastLocalizer::Follow(
    const LocalizationRequest& request,
    const LumaPyramid& pyramid,
    const geometry::Rigid3& predicted) const {
  Followed followed;
  followed.matches =
      FollowLandmarks(*map_, key_frame_, pyramid, request.camera, predicted);
  std::erase_if(followed.matches, [&](const LandmarkMatch& match) {
    return IsMasked(request.masks_px, match.pixel_px);
  });
  std::vector<PoseObservation> observations;
  observations.reserve(followed.matches.size());
  for (const LandmarkMatch& match : followed.matches) {
    observations.push_back(
        {map_->landmarks()[match.landmark].Position(), match.pixel_px});
  }
  auto pose = RefinePoseRobustly(
      request.camera, observations, predicted, RobustPoseOptions());
  if (!pose) return std::nullopt;
  followed.pose = *std::move(pose);
  return followed;
}

std::vector<LandmarkMatch> FastLocalizer::InliersOf(const Followed& followed) {
  std::vector<LandmarkMatch> inliers;
  for (std::size_t i = 0; i < followed.matches.size(); ++i) {
    if (followed.pose.is_inlier[i] != 0) inliers.push_back(followed.matches[i]);
  }
  return inliers;
}

bool FastLocalizer::IsVerified(const Followed& followed,
                               const geometry::CameraModel& camera,
                               int min_inliers) const {
  if (followed.pose.num_inliers < min_inliers) return false;
  if (followed.pose.num_inliers <
      fast_options_.min_inlier_share *
          static_cast<double>(followed.matches.size())) {
    return false;
  }
  return CountOccupiedCells(InliersOf(followed), camera) >=
         fast_options_.min_cells;
}

void FastLocalizer::UpdateMotion(const RobustPose& pose,
                                 nanoseconds capture_time) {
  Motion motion;
  motion.world_from_camera = pose.world_from_camera;
  motion.capture_time = capture_time;
  if (motion_) {
    const double dt = Seconds(capture_time - motion_->capture_time);
    if (dt > 0.0 && dt < 2.0 * kMaxPrediction_s) {
      const Eigen::Vector3d velocity =
          (pose.world_from_camera.translation -
           motion_->world_from_camera.translation) /
          dt;
      const Eigen::Vector3d angular_velocity =
          geometry::RotationVector(
              pose.world_from_camera.rotation *
              motion_->world_from_camera.rotation.conjugate()) /
          dt;
      motion.velocity_world_s =
          motion_->velocity_world_s +
          kVelocityGain * (velocity - motion_->velocity_world_s);
      motion.angular_velocity_world_rad_s =
          motion_->angular_velocity_world_rad_s +
          kVelocityGain *
              (angular_velocity - motion_->angular_velocity_world_rad_s);
    }
  }
  motion_ = motion;
}

void FastLocalizer::MakeKeyFrame(const LocalizationRequest& request,
                                 const Followed& followed) {
  const std::vector<LandmarkMatch> inliers = InliersOf(followed);
  key_frame_.pyramid =
      BuildPyramid(request.frame->luma, /*with_derivatives=*/true);
  key_frame_.landmarks = SpreadOverImage(*map_,
                                         inliers,
                                         request.frame->luma.size(),
                                         fast_options_.max_followed_landmarks);
  if (followed.pose.num_inliers < fast_options_.healthy_inliers) {
    const auto fresh = ProjectFreshLandmarks(
        request, followed.pose.world_from_camera, inliers);
    key_frame_.landmarks.insert(
        key_frame_.landmarks.end(), fresh.begin(), fresh.end());
  }
  key_frame_landmarks_ = key_frame_.landmarks.size();
  frames_since_key_frame_ = 0;
}

std::vector<LandmarkMatch> FastLocalizer::ProjectFreshLandmarks(
    const LocalizationRequest& request,
    const geometry::Rigid3& world_from_camera,
    const std::vector<LandmarkMatch>& known) const {
  std::unordered_set<std::uint32_t> seen;
  for (const LandmarkMatch& match : known) seen.insert(match.landmark);
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<LandmarkMatch> fresh;
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
      fresh.push_back({feature.landmark, *pixel});
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
  result.inliers = InliersOf(followed);
  const geometry::Rigid3& world_from_camera = followed.pose.world_from_camera;
  const double depth =
      MeanDistance(*map_, result.inliers, world_from_camera.translation);
  geometry::Matrix6d covariance =
      kCommonErrorFactor * kCommonErrorFactor * followed.pose.covariance;
  covariance.diagonal().head<3>().array() +=
      std::pow(kFloorOverDistance * depth, 2);
  covariance.diagonal().tail<3>().array() += std::pow(kFloor_rad, 2);
  state_.Succeed(capture_time, world_from_camera, covariance, depth, result);
  return result;
}

LocalizationResult FastLocalizer::UnverifiedResult(nanoseconds capture_time) {
  LocalizationResult result;
  state_.Fail(capture_time, result);
  if (result.state != CameraState::kHeld) {
    motion_.reset();
    key_frame_ = {};
  }
  return result;
}

}  // namespace groundlock::localization
