// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/geometry/pose_ransac.h"
#include "server/localization/follow/fresh_landmarks.h"
#include "server/localization/solvers/agreement.h"

namespace groundlock::localization {
namespace {

using std::chrono::nanoseconds;

// Patches followed from one key frame err in common, and alike in many frames.
constexpr double kFollowErrorFactor = 1.5;
// What is not known of a landmark's depth errs alike for as long as it is
// followed, over some four key frames: the variance of the way adds up to four
// times that of independent errors.
constexpr double kOdometryErrorFactor = 2.0;
// A few patches that are off by a pixel or two, near ones at that, would move
// the camera by centimetres.
constexpr double kLeastFollowGate_px = 0.7;
// Of a rotation by image corners, for what translation does to near ones.
constexpr double kMinFlowSigma_rad = 2e-3;
// Of what was followed without knowing where to: most of it is right.
constexpr double kFarGate_px = 6.0;
constexpr int kFarIterations = 200;
// Of the places of what is followed into frames that show something else, a
// tenth agreed, and once a fifth (docs/method.md, What is believed).
constexpr double kFollowChance = 0.2;

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

}  // namespace

FastLocalizer::FastLocalizer(std::shared_ptr<const map::Map> map,
                             const LocalizerOptions& options,
                             BackgroundRunner run_in_background)
    : map_(std::move(map)),
      options_(options),
      run_in_background_(std::move(run_in_background)),
      known_(*map_, options_) {}

FastLocalizer::~FastLocalizer() { DropPending(); }

void FastLocalizer::Reset() {
  known_.where = Unknown();
  known_.is_tentative = false;
  known_.contradictions = 0;
  known_.camera_state.Reset();
  known_.key_frame = {};
  known_.own.Clear();
  known_.exposure = {};
  known_.bridge.reset();
  known_.last_pyramid.reset();
  known_.last_turn.setIdentity();
  known_.last_time.reset();
  known_.failed_searches = 0;
  DropPending();
}

std::string FastLocalizer::Save() const { return SaveState(known_, *map_); }

absl::Status FastLocalizer::Restore(std::string_view state) {
  ASSIGN_OR_RETURN(FastLocalizerState known, LoadState(state, *map_, options_));
  DropPending();
  known_ = std::move(known);
  if (known_.pending) SeekPending();
  return absl::OkStatus();
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
  ++known_.frame_index;

  AdoptFinishedAnchor();
  const std::optional<GyroscopeTurn> gyro = TakeInGyroscope(request);
  if (!known_.pending) CrossBridge(request, gyro);
  if (known_.HasPose()) {
    known_.filter.Propagate(now);
    if (request.prior) TakeInPrior(*request.prior);
  }
  FrameWork work{request, gyro};
  std::optional<Followed> followed;
  for (const Attempt attempt : Attempts()) {
    followed = (this->*attempt)(work);
    if (followed) break;
  }
  if (followed) {
    known_.failed_searches = 0;
  } else if (!AnchorsInFrame()) {
    SearchInBackground(work);
  }
  LocalizationResult result;
  if (followed) {
    result = known_.is_tentative ? TentativeResult(now)
                                 : TrackedResult(*followed, now);
    KeepUp(request, *followed, work.anchored);
  } else {
    result = UnverifiedResult(now);
  }
  known_.last_pyramid = request.frame->Pyramid();
  known_.last_time = now;
  known_.filter.Remember(PoseFilter::kLastFrame);
  result.ignores_gyroscope = options_.imu && !known_.gyroscope;
  result.lens_contradiction = known_.lens_check.contradiction();
  return result;
}

std::span<const FastLocalizer::Attempt> FastLocalizer::Attempts() const {
  static constexpr Attempt kUnknown[] = {&FastLocalizer::AnchorInFrame};
  static constexpr Attempt kInMap[] = {&FastLocalizer::FollowExpected,
                                       &FastLocalizer::FollowByTurn,
                                       &FastLocalizer::AnchorInFrame,
                                       &FastLocalizer::LeaveMap};
  // Odometry is among what is expected.
  static constexpr Attempt kBeyondMap[] = {&FastLocalizer::FollowExpected,
                                           &FastLocalizer::FollowByTurn,
                                           &FastLocalizer::AnchorInFrame};
  if (!known_.HasPose()) return kUnknown;
  if (known_.LeftMapAt()) return kBeyondMap;
  return kInMap;
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowExpected(
    FrameWork& work) {
  return work.gyro && known_.filter.Remembers(PoseFilter::kLastFrame)
             ? FollowByGyroscope(work.request, *work.gyro)
             : FollowFromExpected(work.request);
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowByTurn(
    FrameWork& work) {
  // Else the bridge, or the gyroscope, has been asked for it already.
  if (work.gyro || !known_.filter.Remembers(PoseFilter::kLastFrame)) {
    return std::nullopt;
  }
  work.turn = TurnSinceLastFrame(work.request);
  if (!work.turn) return std::nullopt;
  known_.filter.UpdateRotation(
      PoseFilter::kLastFrame,
      work.turn->before_from_now,
      std::max(kMinFlowSigma_rad, work.turn->rms_error_rad));
  return FollowFar(work.request);
}

std::optional<FastLocalizer::Followed> FastLocalizer::AnchorInFrame(
    FrameWork& work) {
  if (!AnchorsInFrame()) return std::nullopt;
  auto followed = AnchorNow(work.request);
  work.anchored = followed.has_value();
  return followed;
}

std::optional<FastLocalizer::Followed> FastLocalizer::LeaveMap(
    FrameWork& work) {
  return FollowOdometry(work.request);
}

void FastLocalizer::SearchInBackground(FrameWork& work) {
  if (!known_.pending || IsPendingOutdated()) {
    StartSearch(work.request);
    return;
  }
  if (RenewAnchor(work.request)) return;
  if (!known_.HasPose() && !work.gyro) {
    work.turn = TurnSinceLastFrame(work.request);
  }
  std::optional<Eigen::Quaterniond> before_from_now;
  if (work.gyro) before_from_now = work.gyro->before_from_now;
  if (work.turn) before_from_now = work.turn->before_from_now;
  AddToBridge(work.request, before_from_now);
}

void FastLocalizer::TakeInPrior(const PosePrior& prior) {
  if (prior.position_world) {
    known_.filter.UpdateFromPosition({*prior.position_world,
                                      prior.position_sigma,
                                      prior.position_arm_camera});
  }
  if (prior.rotation) {
    known_.filter.UpdateFromAttitude(
        {*prior.rotation, prior.rotation_sigma_rad});
  }
}

void FastLocalizer::KeepUp(const LocalizationRequest& request,
                           const Followed& followed,
                           bool anchored) {
  ++known_.frames_since_key_frame;
  const auto left_map_at = known_.LeftMapAt();
  const bool leaves_map = !followed.by_map && !left_map_at;
  if (leaves_map) known_.failed_refreshes = 0;
  if (followed.by_map) {
    known_.where = Following();
  } else {
    known_.where =
        Odometry{left_map_at.value_or(known_.filter.pose(PoseFilter::kKeyFrame)
                                          .world_from_camera.translation)};
    known_.key_frame_landmarks =
        std::max(known_.key_frame_landmarks, followed.num_inliers());
  }
  bool is_observed = false;
  if (anchored ||
      known_.frames_since_key_frame >= options_.fast.max_frames_per_key_frame ||
      followed.num_inliers() < known_.key_frame_landmarks * 7 / 10) {
    MakeKeyFrame(request, followed);
    known_.key_frame.own_seen = known_.key_frame.own;
    is_observed = true;
  }
  const int patience =
      request.hurried ? options_.fast.hurried_anchor_factor : 1;
  const bool drifting =
      (known_.key_frames_since_anchor >=
           options_.fast.max_key_frames_per_anchor ||
       followed.num_anchored_inliers < options_.fast.healthy_inliers) &&
      known_.frame_index >=
          known_.last_anchor_frame +
              static_cast<std::uint64_t>(
                  patience * options_.fast.min_frames_between_anchors);
  const nanoseconds since_anchor =
      request.frame->capture_time - known_.last_anchor_time;
  const bool wants_anchor =
      !known_.pending &&
      (drifting ||
       (leaves_map && known_.last_anchor_frame != known_.frame_index) ||
       since_anchor >= patience * options_.fast.anchor_period);
  const int frames_per_observation =
      followed.by_map ? options_.fast.frames_per_observation
                      : options_.fast.frames_per_odometry_observation;
  if (!is_observed &&
      (wants_anchor || known_.frame_index % static_cast<std::uint64_t>(
                                                frames_per_observation) ==
                           0)) {
    known_.key_frame.own_seen = ObserveOwn(request);
  }
  if (wants_anchor) {
    StartRefresh(request);
    known_.pending->own = known_.key_frame.own_seen;
  }
}

MovingCamera FastLocalizer::PredictedCamera() const {
  MovingCamera predicted;
  predicted.world_from_camera =
      known_.key_frame.world_from_camera *
      known_.filter.pose(PoseFilter::kKeyFrame).world_from_camera.Inverse() *
      known_.filter.pose().world_from_camera;
  predicted.velocity_s = known_.filter.velocity_s();
  predicted.covariance =
      known_.filter.RelativeCovariance(PoseFilter::kKeyFrame);
  predicted.exposure_s = known_.exposure.seconds();
  return predicted;
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowFromExpected(
    const LocalizationRequest& request) {
  auto followed = Follow(request);
  if (!followed && known_.LeftMapAt()) followed = FollowOdometry(request);
  if (!followed) followed = FollowFar(request);
  return followed;
}

bool FastLocalizer::CanFollowInto(const image::Frame& frame) const {
  // A sender may change its resolution; then only descriptors match.
  return !known_.key_frame.landmarks.empty() &&
         known_.key_frame.pyramid->size_px == frame.size_px();
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
                                    known_.key_frame,
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
  geometry::PoseRansacOptions ransac;
  ransac.max_error_px = kFarGate_px;
  ransac.max_iterations = kFarIterations;
  ransac.seed = base::MixSeed(options_.seed, request.frame->sequence);
  const auto found =
      geometry::EstimatePoseRansac(request.camera, p_world, pixel_px, ransac);
  if (!found.ok()) return std::nullopt;
  predicted.world_from_camera = found->camera_from_world.Inverse();
  predicted.covariance.reset();
  return FollowFrom(predicted, request, Support::kMap);
}

std::vector<Eigen::Vector2d> FastLocalizer::InView(
    const KeyFrame& key_frame,
    const geometry::Rigid3& world_from_camera,
    const LocalizationRequest& request) const {
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<Eigen::Vector2d> pixels_px;
  pixels_px.reserve(key_frame.landmarks.size());
  for (const FollowedLandmark& landmark : key_frame.landmarks) {
    const auto pixel_px = request.camera.ImageFromCamera(
        camera_from_world * table().Position(landmark.match.landmark));
    if (!pixel_px || !request.camera.IsInsideImage(*pixel_px)) continue;
    const bool is_masked = std::any_of(
        request.masks_px.begin(),
        request.masks_px.end(),
        [&](const geometry::Box2& mask) { return mask.Contains(*pixel_px); });
    if (!is_masked) pixels_px.push_back(*pixel_px);
  }
  return pixels_px;
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
                                    by_map ? known_.key_frame : with_own,
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
  std::vector<Eigen::Vector2d> agreeing_px;
  for (std::size_t i = 0; i < landmarks.size(); ++i) {
    if (pose->is_inlier[i] == 0) continue;
    agreeing_px.push_back(landmarks[i].match.pixel_px);
    if (known_.own.Owns(landmarks[i].match.landmark)) {
      followed.own_inliers.push_back(landmarks[i].match);
      continue;
    }
    followed.inliers.push_back(landmarks[i]);
    followed.num_anchored_inliers += landmarks[i].is_anchored ? 1 : 0;
  }
  const std::vector<Eigen::Vector2d> expected_px = InView(
      by_map ? known_.key_frame : with_own, pose->world_from_camera, request);
  const double log_false_alarms =
      LogFalseAlarms({CountPlaces(agreeing_px, request.camera),
                      CountPlaces(expected_px, request.camera)},
                     kFollowChance);
  if (!IsBelieved(log_false_alarms)) return std::nullopt;
  const double factor =
      kFollowErrorFactor * (by_map ? 1.0 : kOdometryErrorFactor);
  const PoseEstimate measured{pose->world_from_camera,
                              factor * factor * pose->covariance};
  // A motion that nobody expects needs so much more to agree.
  if (!known_.filter.UpdateRelative(PoseFilter::kKeyFrame,
                                    known_.key_frame.world_from_camera,
                                    measured,
                                    LogMargin(log_false_alarms))) {
    return std::nullopt;
  }
  ObserveExposure(table(),
                  known_.key_frame,
                  *request.frame->Pyramid(),
                  request.camera,
                  {pose->world_from_camera, known_.filter.velocity_s()},
                  followed.inliers,
                  known_.exposure);
  return followed;
}

std::optional<FlowRotation> FastLocalizer::TurnSinceLastFrame(
    const LocalizationRequest& request) {
  if (known_.last_pyramid == nullptr) return std::nullopt;
  if (known_.HasPose() && known_.filter.Remembers(PoseFilter::kLastFrame)) {
    known_.last_turn = known_.filter.pose(PoseFilter::kLastFrame)
                           .world_from_camera.rotation.conjugate() *
                       known_.filter.pose().world_from_camera.rotation;
  }
  const auto turn =
      EstimateRotation(*known_.last_pyramid,
                       *request.frame->Pyramid(),
                       request.camera,
                       request.masks_px,
                       known_.last_turn,
                       base::MixSeed(options_.seed, request.frame->sequence));
  if (turn) known_.last_turn = turn->before_from_now;
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
  known_.key_frame.landmarks = SpreadOverImage(
      *map_, landmarks, pyramid->size_px, options_.fast.max_followed_landmarks);
  known_.key_frame.own.clear();
  known_.key_frame.own_seen.clear();
  known_.key_frame.pyramid = std::move(pyramid);
  known_.key_frame.world_from_camera = world_from_camera;
  known_.key_frame.velocity_s = velocity_s;
  known_.key_frame_landmarks = known_.key_frame.landmarks.size();
  known_.frames_since_key_frame = 0;
}

void FastLocalizer::MakeKeyFrame(const LocalizationRequest& request,
                                 const Followed& followed) {
  ++known_.key_frames_since_anchor;
  std::vector<LandmarkMatch> own = ObserveOwn(request);
  MoveOwnLandmarks();
  if (!followed.by_map) AddOdometryDrift();
  known_.filter.Remember(PoseFilter::kKeyFrame);
  const geometry::Rigid3 world_from_camera =
      known_.filter.pose().world_from_camera;
  std::vector<FollowedLandmark> landmarks;
  // Odometry may be off by more than is expected of the map's landmarks: only
  // an anchor tells where they are.
  if (followed.by_map) landmarks = followed.inliers;
  if (followed.by_map &&
      followed.num_anchored_inliers < options_.fast.full_inliers) {
    const auto fresh =
        ProjectFreshLandmarks(*map_,
                              request.camera,
                              world_from_camera,
                              request.masks_px,
                              landmarks,
                              options_.min_landmark_views,
                              options_.fast.max_followed_landmarks -
                                  static_cast<int>(landmarks.size()));
    landmarks.insert(landmarks.end(), fresh.begin(), fresh.end());
  }
  SetKeyFrame(request.frame->Pyramid(),
              request.camera,
              world_from_camera,
              known_.filter.velocity_s(),
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
  const PoseEstimate pose = known_.filter.pose();
  const double depth =
      MeanDistance(followed.by_map ? result.inliers : followed.own_inliers,
                   pose.world_from_camera.translation);
  known_.camera_state.Succeed(capture_time,
                              pose.world_from_camera,
                              pose.covariance,
                              depth,
                              result,
                              followed.by_map);
  return result;
}

LocalizationResult FastLocalizer::TentativeResult(
    nanoseconds capture_time) const {
  LocalizationResult result;
  known_.camera_state.Fail(capture_time, std::nullopt, result);
  return result;
}

LocalizationResult FastLocalizer::UnverifiedResult(nanoseconds capture_time) {
  LocalizationResult result;
  std::optional<PoseEstimate> bridged;
  const bool was_tentative = std::exchange(known_.is_tentative, false);
  if (known_.HasPose() && !was_tentative) bridged = known_.filter.pose();
  known_.camera_state.Fail(capture_time, bridged, result);
  if (result.state != CameraState::kHeld || was_tentative) {
    known_.where = Unknown();
    known_.key_frame = {};
    known_.own.Clear();
  } else if (known_.HasPose()) {
    known_.where = Coasting{known_.LeftMapAt()};
  }
  return result;
}

}  // namespace groundlock::localization
