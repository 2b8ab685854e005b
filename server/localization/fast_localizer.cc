// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/localization/fresh_landmarks.h"
#include "server/localization/pose_ransac.h"

namespace groundlock::localization {
namespace {

using std::chrono::nanoseconds;

// The acceleration of a camera whose map has no scale, relative to the spread
// of the map's cameras.
constexpr double kAccelerationOverSpread_s2 = 0.3;
// Patches followed from one key frame err in common, and alike in many frames.
constexpr double kFollowErrorFactor = 1.5;
// What is not known of a landmark's depth errs alike for as long as it is
// followed, over some four key frames: the variance of the way adds up to four
// times that of independent errors.
constexpr double kOdometryErrorFactor = 2.0;
// A few patches that are off by a pixel or two, near ones at that, would move
// the camera by centimetres.
constexpr double kLeastFollowGate_px = 0.7;
// What is followed then overrules the camera's expected motion.
constexpr int kJoltInliers = 80;
constexpr double kJoltInlierShare = 0.8;
// Of a rotation by image corners, for what translation does to near ones.
constexpr double kMinFlowSigma_rad = 2e-3;
// Of what was followed without knowing where to: most of it is right.
constexpr double kFarGate_px = 6.0;
constexpr int kFarIterations = 200;

std::vector<LandmarkMatch> MatchesOf(
    const std::vector<FollowedLandmark>& landmarks) {
  std::vector<LandmarkMatch> matches;
  matches.reserve(landmarks.size());
  for (const FollowedLandmark& landmark : landmarks) {
    matches.push_back(landmark.match);
  }
  return matches;
}

std::vector<FollowedLandmark> WithoutMasked(
    std::vector<FollowedLandmark> landmarks,
    std::span<const geometry::Box2> masks_px) {
  std::erase_if(landmarks, [&](const FollowedLandmark& landmark) {
    return std::any_of(
        masks_px.begin(), masks_px.end(), [&](const geometry::Box2& mask) {
          return mask.Contains(landmark.match.pixel_px);
        });
  });
  return landmarks;
}

PoseFilterOptions MotionOptionsFor(const map::Map& map,
                                   const LocalizerOptions& localizer) {
  PoseFilterOptions options;
  options.imu = localizer.imu;
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
      filter_(MotionOptionsFor(*map_, options_)),
      own_(static_cast<std::uint32_t>(map_->landmarks().size())) {
  if (options_.imu) gyroscope_.emplace(*options_.imu);
}

FastLocalizer::~FastLocalizer() { DropPending(); }

void FastLocalizer::Reset() {
  has_pose_ = false;
  state_.Reset();
  key_frame_ = {};
  own_.Clear();
  left_map_at_.reset();
  exposure_ = {};
  bridge_.reset();
  last_pyramid_.reset();
  last_turn_.setIdentity();
  last_time_ = nanoseconds{-1};
  failed_searches_ = 0;
  DropPending();
}

absl::StatusOr<LocalizationResult> FastLocalizer::Localize(
    const LocalizationRequest& given) {
  RETURN_IF_ERROR(ValidateRequest(given));
  RETURN_IF_ERROR(base::Annotate(map_->damage(), "the map is damaged"));
  LocalizationRequest request = given;
  if (given.prior) {
    ASSIGN_OR_RETURN(request.prior, PlaceInWorld(*map_, *given.prior));
  }
  const nanoseconds now = request.frame->capture_time;
  ++frame_index_;

  AdoptFinishedAnchor();
  const std::optional<GyroscopeTurn> gyro = TakeInGyroscope(request);
  if (pending_ == nullptr) CrossBridge(request, gyro);
  std::optional<Followed> followed;
  if (has_pose_) {
    filter_.Propagate(now);
    followed = gyro && filter_.Remembers(PoseFilter::kLastFrame)
                   ? FollowByGyroscope(request, *gyro)
                   : FollowFromExpected(request);
  }
  std::optional<FlowRotation> turn;
  // Else the bridge, or the gyroscope, has been asked for it already.
  if (!followed && !gyro && has_pose_ &&
      filter_.Remembers(PoseFilter::kLastFrame)) {
    turn = TurnSinceLastFrame(request);
  }
  if (turn) {
    filter_.UpdateRotation(PoseFilter::kLastFrame,
                           turn->before_from_now,
                           std::max(kMinFlowSigma_rad, turn->rms_error_rad));
    followed = FollowFar(request);
  }
  bool anchored = false;
  const bool anchors_now = options_.wait_for_anchor || !run_in_background_;
  if (!followed && anchors_now) {
    followed = AnchorNow(request);
    anchored = followed.has_value();
  }
  if (!followed && has_pose_ && !left_map_at_) {
    followed = FollowOdometry(request);
  }
  if (!followed && !anchors_now) {
    if (!pending_ || IsPendingOutdated()) {
      StartSearch(request);
    } else if (!RenewAnchor(request)) {
      if (!has_pose_ && !gyro) turn = TurnSinceLastFrame(request);
      std::optional<Eigen::Quaterniond> before_from_now;
      if (gyro) before_from_now = gyro->before_from_now;
      if (turn) before_from_now = turn->before_from_now;
      AddToBridge(request, before_from_now);
    }
  }
  is_following_ = followed.has_value();
  if (is_following_) failed_searches_ = 0;
  LocalizationResult result;
  if (followed) {
    result = TrackedResult(*followed, now);
    KeepUp(request, *followed, anchored);
  } else {
    result = UnverifiedResult(now);
  }
  last_pyramid_ = request.frame->Pyramid();
  last_time_ = now;
  filter_.Remember(PoseFilter::kLastFrame);
  result.ignores_gyroscope = options_.imu && !gyroscope_;
  result.lens_contradiction = lens_check_.contradiction();
  return result;
}

void FastLocalizer::KeepUp(const LocalizationRequest& request,
                           const Followed& followed,
                           bool anchored) {
  ++frames_since_key_frame_;
  const bool leaves_map = !followed.by_map && !left_map_at_;
  if (followed.by_map) {
    left_map_at_.reset();
  } else {
    if (leaves_map) {
      failed_refreshes_ = 0;
      left_map_at_ =
          filter_.pose(PoseFilter::kKeyFrame).world_from_camera.translation;
    }
    key_frame_landmarks_ =
        std::max(key_frame_landmarks_, followed.num_inliers());
  }
  bool is_observed = false;
  if (anchored ||
      frames_since_key_frame_ >= fast_options_.max_frames_per_key_frame ||
      followed.num_inliers() < key_frame_landmarks_ * 7 / 10) {
    MakeKeyFrame(request, followed);
    key_frame_.own_seen = key_frame_.own;
    is_observed = true;
  }
  const int patience =
      request.hurried ? fast_options_.hurried_anchor_factor : 1;
  const bool drifting =
      (key_frames_since_anchor_ >= fast_options_.max_key_frames_per_anchor ||
       followed.num_anchored_inliers < fast_options_.healthy_inliers) &&
      frame_index_ >=
          last_anchor_frame_ +
              static_cast<std::uint64_t>(
                  patience * fast_options_.min_frames_between_anchors);
  const nanoseconds since_anchor =
      request.frame->capture_time - last_anchor_time_;
  const bool wants_anchor =
      !pending_ &&
      (drifting || (leaves_map && last_anchor_frame_ != frame_index_) ||
       since_anchor >= patience * fast_options_.anchor_period);
  const int frames_per_observation =
      followed.by_map ? fast_options_.frames_per_observation
                      : fast_options_.frames_per_odometry_observation;
  if (!is_observed &&
      (wants_anchor ||
       frame_index_ % static_cast<std::uint64_t>(frames_per_observation) ==
           0)) {
    key_frame_.own_seen = ObserveOwn(request);
  }
  if (wants_anchor) {
    StartRefresh(request);
    pending_own_ = key_frame_.own_seen;
  }
}

MovingCamera FastLocalizer::PredictedCamera() const {
  MovingCamera predicted;
  predicted.world_from_camera =
      key_frame_.world_from_camera *
      filter_.pose(PoseFilter::kKeyFrame).world_from_camera.Inverse() *
      filter_.pose().world_from_camera;
  predicted.velocity_s = filter_.velocity_s();
  predicted.covariance = filter_.RelativeCovariance(PoseFilter::kKeyFrame);
  predicted.exposure_s = exposure_.seconds();
  return predicted;
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowFromExpected(
    const LocalizationRequest& request) {
  auto followed = Follow(request);
  if (!followed && left_map_at_) followed = FollowOdometry(request);
  if (!followed) followed = FollowFar(request);
  return followed;
}

bool FastLocalizer::CanFollowInto(const image::Frame& frame) const {
  // A sender may change its resolution; then only descriptors match.
  return !key_frame_.landmarks.empty() &&
         key_frame_.pyramid->size_px == frame.size_px();
}

std::optional<FastLocalizer::Followed> FastLocalizer::Follow(
    const LocalizationRequest& request) {
  if (!CanFollowInto(*request.frame)) return std::nullopt;
  return FollowFrom(PredictedCamera(), request, Support::kMap);
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowFar(
    const LocalizationRequest& request) {
  if (!CanFollowInto(*request.frame)) return std::nullopt;
  MovingCamera predicted = PredictedCamera();
  const std::vector<FollowedLandmark> landmarks =
      WithoutMasked(FollowLandmarks(*map_,
                                    key_frame_,
                                    *request.frame->Pyramid(),
                                    request.camera,
                                    predicted,
                                    Reach::kFar),
                    request.masks_px);
  std::vector<Eigen::Vector3d> p_world;
  std::vector<Eigen::Vector2d> pixel_px;
  for (const FollowedLandmark& landmark : landmarks) {
    p_world.push_back(map_->landmarks()[landmark.match.landmark].Position());
    pixel_px.push_back(landmark.match.pixel_px);
  }
  PoseRansacOptions ransac;
  ransac.max_error_px = kFarGate_px;
  ransac.max_iterations = kFarIterations;
  ransac.seed = base::MixSeed(options_.seed, request.frame->sequence);
  const auto found =
      EstimatePoseRansac(request.camera, p_world, pixel_px, ransac);
  if (!found.ok()) return std::nullopt;
  predicted.world_from_camera = found->camera_from_world.Inverse();
  predicted.covariance.reset();
  return FollowFrom(predicted, request, Support::kMap);
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowFrom(
    const MovingCamera& predicted,
    const LocalizationRequest& request,
    Support support) {
  const bool by_map = support == Support::kMap;
  KeyFrame with_own;
  if (!by_map) with_own = WithOwnLandmarks(predicted, request.camera);
  const std::vector<FollowedLandmark> landmarks =
      WithoutMasked(FollowLandmarks(table(),
                                    by_map ? key_frame_ : with_own,
                                    *request.frame->Pyramid(),
                                    request.camera,
                                    predicted,
                                    Reach::kNear),
                    request.masks_px);
  RobustPoseOptions refinement;
  refinement.least_gate_px = kLeastFollowGate_px;
  refinement.expected = predicted.Expected();
  const auto pose =
      RefinePoseRobustly(request.camera,
                         Observations(landmarks, predicted, request.camera),
                         predicted.world_from_camera,
                         refinement);
  if (!pose) return std::nullopt;
  Followed followed;
  followed.by_map = by_map;
  followed.mean_error_px = pose->mean_error_px;
  std::vector<LandmarkMatch> agreeing;
  for (std::size_t i = 0; i < landmarks.size(); ++i) {
    if (pose->is_inlier[i] == 0) continue;
    agreeing.push_back(landmarks[i].match);
    if (own_.Owns(landmarks[i].match.landmark)) {
      followed.own_inliers.push_back(landmarks[i].match);
      continue;
    }
    followed.inliers.push_back(landmarks[i]);
    followed.num_anchored_inliers += landmarks[i].is_anchored ? 1 : 0;
  }
  if (pose->num_inliers < fast_options_.min_inliers ||
      pose->num_inliers < fast_options_.min_inlier_share *
                              static_cast<double>(landmarks.size()) ||
      CountOccupiedCells(agreeing, request.camera) < fast_options_.min_cells) {
    return std::nullopt;
  }
  const double factor =
      kFollowErrorFactor * (by_map ? 1.0 : kOdometryErrorFactor);
  const PoseEstimate measured{pose->world_from_camera,
                              factor * factor * pose->covariance};
  // A camera is pushed more easily than so many landmarks err alike.
  const bool may_be_jolt =
      pose->num_inliers >= kJoltInliers &&
      pose->num_inliers >=
          kJoltInlierShare * static_cast<double>(landmarks.size());
  const geometry::Rigid3& reference = key_frame_.world_from_camera;
  if (!filter_.UpdateRelative(PoseFilter::kKeyFrame, reference, measured) &&
      !(may_be_jolt && filter_.UpdateRelativeAfterJolt(
                           PoseFilter::kKeyFrame, reference, measured))) {
    return std::nullopt;
  }
  ObserveExposure(table(),
                  key_frame_,
                  *request.frame->Pyramid(),
                  request.camera,
                  {pose->world_from_camera, filter_.velocity_s()},
                  followed.inliers,
                  exposure_);
  return followed;
}

std::optional<FlowRotation> FastLocalizer::TurnSinceLastFrame(
    const LocalizationRequest& request) {
  if (last_pyramid_ == nullptr) return std::nullopt;
  if (has_pose_ && filter_.Remembers(PoseFilter::kLastFrame)) {
    last_turn_ = filter_.pose(PoseFilter::kLastFrame)
                     .world_from_camera.rotation.conjugate() *
                 filter_.pose().world_from_camera.rotation;
  }
  const auto turn =
      EstimateRotation(*last_pyramid_,
                       *request.frame->Pyramid(),
                       request.camera,
                       request.masks_px,
                       last_turn_,
                       base::MixSeed(options_.seed, request.frame->sequence));
  if (turn) last_turn_ = turn->before_from_now;
  return turn;
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
  key_frame_.own.clear();
  key_frame_.own_seen.clear();
  key_frame_.pyramid = std::move(pyramid);
  key_frame_.world_from_camera = world_from_camera;
  key_frame_.velocity_s = velocity_s;
  key_frame_landmarks_ = key_frame_.landmarks.size();
  frames_since_key_frame_ = 0;
}

void FastLocalizer::MakeKeyFrame(const LocalizationRequest& request,
                                 const Followed& followed) {
  ++key_frames_since_anchor_;
  std::vector<LandmarkMatch> own = ObserveOwn(request);
  MoveOwnLandmarks();
  if (!followed.by_map) AddOdometryDrift();
  filter_.Remember(PoseFilter::kKeyFrame);
  const geometry::Rigid3 world_from_camera = filter_.pose().world_from_camera;
  std::vector<FollowedLandmark> landmarks;
  // Odometry may be off by more than is expected of the map's landmarks: only
  // an anchor tells where they are.
  if (followed.by_map) landmarks = followed.inliers;
  if (followed.by_map &&
      followed.num_anchored_inliers < fast_options_.full_inliers) {
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
  SetKeyFrame(request.frame->Pyramid(),
              request.camera,
              world_from_camera,
              filter_.velocity_s(),
              std::move(landmarks));
  if (!followed.by_map) {
    const auto adopted = AsOwn(followed.inliers, request.camera);
    own.insert(own.end(), adopted.begin(), adopted.end());
  }
  SetOwnLandmarks(request.camera, request.masks_px, std::move(own));
}

double FastLocalizer::MeanDistance(const std::vector<LandmarkMatch>& matches,
                                   const Eigen::Vector3d& center_world) const {
  double sum = 0.0;
  for (const LandmarkMatch& match : matches) {
    sum += (table().Position(match.landmark) - center_world).norm();
  }
  return matches.empty() ? 1.0 : sum / static_cast<double>(matches.size());
}

LocalizationResult FastLocalizer::TrackedResult(const Followed& followed,
                                                nanoseconds capture_time) {
  LocalizationResult result;
  result.num_inliers = static_cast<int>(followed.num_inliers());
  result.mean_reprojection_error_px = followed.mean_error_px;
  result.inliers = MatchesOf(followed.inliers);
  const PoseEstimate pose = filter_.pose();
  const double depth =
      MeanDistance(followed.by_map ? result.inliers : followed.own_inliers,
                   pose.world_from_camera.translation);
  state_.Succeed(capture_time,
                 pose.world_from_camera,
                 pose.covariance,
                 depth,
                 result,
                 followed.by_map);
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
    own_.Clear();
    left_map_at_.reset();
  }
  return result;
}

}  // namespace groundlock::localization
