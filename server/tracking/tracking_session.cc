// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/tracking_session.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/tracking/ground_target.h"
#include "server/tracking/occlusion.h"
#include "server/tracking/session_camera.h"
#include "server/tracking/session_targets.h"
#include "server/tracking/standing_landmarks.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::CameraModel;
using localization::CameraState;
using Clock = std::chrono::steady_clock;

// A moving thing's mask is larger than its box by this on every side: its
// shadow, and the box's own error.
constexpr double kMaskMargin = 0.15;

absl::Status CheckBox(const Box2& box_px) {
  if (!box_px.IsFinite() || !(box_px.width() > 0.0) ||
      !(box_px.height() > 0.0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("box (",
                     box_px.x(),
                     ", ",
                     box_px.y(),
                     ", ",
                     box_px.width(),
                     ", ",
                     box_px.height(),
                     ") must be finite and of positive size"));
  }
  return absl::OkStatus();
}

Box2 Enlarged(const Box2& box_px, double share) {
  return Box2::FromCenter(box_px.center_px(),
                          (1.0 + 2.0 * share) * box_px.size_px());
}

class Session : public TrackingSession {
 public:
  Session(std::unique_ptr<localization::Localizer> localizer,
          std::shared_ptr<const ground::GroundSurface> ground,
          const CameraModel& camera,
          const SessionOptions& options,
          std::shared_ptr<const map::Map> map)
      : localizer_(std::move(localizer)),
        ground_(std::move(ground)),
        ground_is_known_(map == nullptr || map->info().ground_state !=
                                               map::GroundState::kUnknown),
        metric_(map != nullptr && map->info().metric),
        camera_(camera),
        options_(options) {
    if (map != nullptr && options_.reason_about_occlusion) {
      standing_.emplace(std::move(map),
                        options_.localization.min_landmark_views);
    }
  }

  absl::Status SetTarget(const std::string& id,
                         const Box2& box_px,
                         std::optional<std::uint64_t> frame_sequence,
                         const TargetBody& body) override;
  absl::Status MoveTarget(const std::string& id, const Box2& box_px) override;
  absl::Status DropTarget(const std::string& id) override;
  std::vector<std::string> TargetIds() const override;
  void SetHurried(bool hurried) override { hurried_ = hurried; }
  absl::StatusOr<FrameResult> ProcessFrame(
      const image::Frame& frame,
      const std::optional<CameraModel>& camera,
      const SensorReadings& sensors,
      std::vector<absl::Status>* target_errors) override;
  std::string SaveCamera() const override;
  absl::Status RestoreCamera(std::string_view state) override;
  absl::StatusOr<std::string> SaveTargets() const override;
  absl::Status RestoreTargets(std::string_view state) override;

 private:
  absl::Status CheckFrame(const image::Frame& frame,
                          const CameraModel& camera) const;
  absl::Status Localize(const image::Frame& frame,
                        const CameraModel& camera,
                        const SensorReadings& sensors,
                        FrameResult& result);
  void SetView(const FrameResult& result, const CameraModel& camera);
  CameraView ViewFrom(const geometry::Rigid3& world_from_camera) const;
  absl::Status TrackTargets(const image::Frame& frame,
                            std::vector<TargetResult>& results);
  // Indices of the targets, those nearest to the camera first, and how far the
  // last of them is away: 0 if none is on the ground.
  struct Order {
    std::vector<std::size_t> nearest_first;
    double farthest_m = 0.0;
  };
  Order OrderTargets(std::chrono::nanoseconds time) const;
  Surroundings SurroundingsOf(std::size_t index, std::chrono::nanoseconds time);
  void StartTargets(const image::Frame& frame,
                    std::vector<TargetResult>& results,
                    std::vector<absl::Status>* target_errors);
  movers::MoversReport LookForMovers(const image::Frame& frame,
                                     const FrameResult& result);
  const CameraView* view() const { return view_ ? &*view_ : nullptr; }
  void EraseTrack(const std::string& id);

  std::unique_ptr<localization::Localizer> localizer_;
  const std::shared_ptr<const ground::GroundSurface> ground_;
  const bool ground_is_known_;
  const bool metric_;
  CameraModel camera_;
  SessionOptions options_;
  std::vector<std::unique_ptr<TargetTrack>> tracks_;
  std::vector<PendingTarget> pending_;
  std::optional<std::chrono::nanoseconds> last_time_;
  cv::Size size_px_;  // without a map: of all frames; empty before the first
  bool hurried_ = false;
  std::optional<StandingLandmarks> standing_;
  CameraModel view_camera_;  // that view_ points to
  std::optional<CameraView> view_;
  movers::MoverFinder mover_finder_;
};

void Session::EraseTrack(const std::string& id) {
  std::erase_if(tracks_, [&](const auto& track) { return track->id() == id; });
  for (const auto& track : tracks_) track->Forget(id);
}

std::vector<std::string> Session::TargetIds() const {
  std::vector<std::string> ids;
  for (const auto& track : tracks_) ids.push_back(track->id());
  for (const PendingTarget& pending : pending_) {
    if (std::find(ids.begin(), ids.end(), pending.id) == ids.end()) {
      ids.push_back(pending.id);
    }
  }
  return ids;
}

absl::Status Session::SetTarget(const std::string& id,
                                const Box2& box_px,
                                std::optional<std::uint64_t> frame_sequence,
                                const TargetBody& body) {
  RETURN_IF_ERROR(CheckBox(box_px));
  ASSIGN_OR_RETURN(const std::optional<BodyKind> kind, KindOf(body));
  const std::vector<std::string> ids = TargetIds();
  if (std::find(ids.begin(), ids.end(), id) == ids.end() &&
      ids.size() >= static_cast<std::size_t>(options_.max_targets)) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the session has ", ids.size(), " targets, the most it may have"));
  }
  std::erase_if(pending_, [&](const PendingTarget& p) { return p.id == id; });
  pending_.push_back({id, box_px, frame_sequence, kind});
  return absl::OkStatus();
}

absl::Status Session::MoveTarget(const std::string& id, const Box2& box_px) {
  RETURN_IF_ERROR(CheckBox(box_px));
  bool found = false;
  for (const auto& track : tracks_) {
    if (track->id() != id) continue;
    track->Move(box_px);
    found = true;
  }
  for (PendingTarget& pending : pending_) {
    if (pending.id != id) continue;
    if (!found) pending.box_px = box_px;
    found = true;
  }
  if (found) return absl::OkStatus();
  return absl::NotFoundError(absl::StrCat("no target '", id, "'"));
}

absl::Status Session::DropTarget(const std::string& id) {
  const std::size_t before = tracks_.size() + pending_.size();
  EraseTrack(id);
  std::erase_if(pending_, [&](const PendingTarget& p) { return p.id == id; });
  if (tracks_.size() + pending_.size() < before) return absl::OkStatus();
  return absl::NotFoundError(absl::StrCat("no target '", id, "'"));
}

absl::Status Session::CheckFrame(const image::Frame& frame,
                                 const CameraModel& camera) const {
  const cv::Size size = frame.size_px();
  if (frame.luma.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("frame ", frame.sequence, " has no pixels"));
  }
  if (size.width != camera.width_px() || size.height != camera.height_px()) {
    return absl::InvalidArgumentError(absl::StrCat("frame ",
                                                   frame.sequence,
                                                   " is ",
                                                   size.width,
                                                   "x",
                                                   size.height,
                                                   " px, the camera ",
                                                   camera.width_px(),
                                                   "x",
                                                   camera.height_px()));
  }
  // A map says where a target is in another picture of the camera; boxes alone
  // do not.
  if (localizer_ == nullptr && !size_px_.empty() && size != size_px_) {
    return absl::InvalidArgumentError(
        absl::StrCat("the picture is ",
                     size.width,
                     "x",
                     size.height,
                     " px, those before it ",
                     size_px_.width,
                     "x",
                     size_px_.height,
                     ": without a map targets are not followed into a picture "
                     "of another size; a session of its own does that"));
  }
  if (last_time_ && frame.capture_time < *last_time_) {
    return absl::InvalidArgumentError(
        absl::StrCat("frame ",
                     frame.sequence,
                     " was captured at ",
                     frame.capture_time.count(),
                     " ns, before the previous frame's ",
                     last_time_->count(),
                     " ns"));
  }
  return absl::OkStatus();
}

absl::Status Session::Localize(const image::Frame& frame,
                               const CameraModel& camera,
                               const SensorReadings& sensors,
                               FrameResult& result) {
  if (localizer_ == nullptr) return absl::OkStatus();
  localization::LocalizationRequest request{
      &frame, camera, {}, sensors.prior, hurried_, sensors.inertial};
  for (const auto& track : tracks_) {
    // The camera's pose in this frame is not known yet: the last one serves.
    const auto box_px = track->ExpectedBox(view(), frame.capture_time);
    if (box_px) request.masks_px.push_back(Enlarged(*box_px, kMaskMargin));
  }
  for (const PendingTarget& pending : pending_) {
    if (pending.frame_sequence.value_or(0) <= frame.sequence) {
      request.masks_px.push_back(Enlarged(pending.box_px, kMaskMargin));
    }
  }
  ASSIGN_OR_RETURN(result.camera, localizer_->Localize(request));
  return absl::OkStatus();
}

void Session::SetView(const FrameResult& result, const CameraModel& camera) {
  view_.reset();
  // Nothing stands on a guess: targets then live in the image.
  if (!ground_is_known_) return;
  const bool tracked = result.camera.state == CameraState::kTracked ||
                       result.camera.state == CameraState::kOdometry;
  if (!result.camera.world_from_camera ||
      (!tracked && result.camera.state != CameraState::kHeld)) {
    return;
  }
  view_camera_ = camera;
  CameraView view = ViewFrom(*result.camera.world_from_camera);
  view.pose_covariance = result.camera.covariance;
  view.verified = tracked;
  view.reset_count = result.camera.reset_count;
  const auto height_m =
      ground_->HeightOf(view.view.world_from_camera.translation);
  if (!(height_m.value_or(ground::CameraHeight_m(view.view)) > 0.0)) return;
  view_ = view;
}

CameraView Session::ViewFrom(const geometry::Rigid3& world_from_camera) const {
  CameraView view;
  view.view = {&view_camera_, world_from_camera, ground_->reference_world()};
  view.surface = ground_;
  view.metric = metric_;
  return view;
}

Session::Order Session::OrderTargets(std::chrono::nanoseconds time) const {
  std::vector<std::pair<double, std::size_t>> ranges;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    const auto body = view() != nullptr ? tracks_[i]->ExpectBody(*view(), time)
                                        : std::nullopt;
    const double range_m = body ? (body->box_world.BottomCenterWorld() -
                                   view()->view.world_from_camera.translation)
                                      .norm()
                                : 0.0;
    ranges.emplace_back(range_m, i);
  }
  std::sort(ranges.begin(), ranges.end());
  Order order;
  for (const auto& [range_m, i] : ranges) {
    order.nearest_first.push_back(i);
    order.farthest_m = range_m;
  }
  return order;
}

Surroundings Session::SurroundingsOf(std::size_t index,
                                     std::chrono::nanoseconds time) {
  Surroundings around;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (i == index) continue;
    const auto seen = tracks_[i]->SeenBox();
    if (seen) {
      around.taken.push_back({tracks_[i]->id(), *seen});
    } else {
      around.others_are_unseen = true;
    }
  }
  around.max_search_places = hurried_
                                 ? std::min(options_.max_hurried_search_places,
                                            options_.max_search_places)
                                 : options_.max_search_places;
  if (view() == nullptr || !options_.reason_about_occlusion) return around;
  around.may_hide = true;
  around.standing = standing_ ? &*standing_ : nullptr;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (i == index || !tracks_[i]->IsKnownToStand(time)) continue;
    auto body = tracks_[i]->ExpectBody(*view(), time);
    if (body) around.bodies.push_back(*std::move(body));
  }
  return around;
}

absl::Status Session::TrackTargets(const image::Frame& frame,
                                   std::vector<TargetResult>& results) {
  if (tracks_.empty()) return absl::OkStatus();
  const Order order = OrderTargets(frame.capture_time);
  if (standing_ && order.farthest_m > 0.0) {
    standing_->Follow(view()->view, order.farthest_m);
  }
  results.resize(tracks_.size());
  // A target that hides another is looked for before that one.
  for (const std::size_t i : order.nearest_first) {
    ASSIGN_OR_RETURN(results[i],
                     tracks_[i]->Process(
                         frame, view(), SurroundingsOf(i, frame.capture_time)));
  }
  return absl::OkStatus();
}

void Session::StartTargets(const image::Frame& frame,
                           std::vector<TargetResult>& results,
                           std::vector<absl::Status>* target_errors) {
  std::vector<PendingTarget> later;
  for (PendingTarget& pending : pending_) {
    if (pending.frame_sequence.value_or(0) > frame.sequence) {
      later.push_back(std::move(pending));
      continue;
    }
    auto track = TargetTrack::Start(
        pending.id, frame, view(), pending.box_px, options_, pending.kind);
    if (!track.ok()) {
      if (target_errors != nullptr) {
        target_errors->push_back(base::Annotate(
            track.status(),
            base::Std(absl::StrCat("target '", pending.id, "'"))));
      }
      continue;
    }
    results.push_back((*track)->StartResult(view()));
    tracks_.push_back(*std::move(track));
  }
  pending_ = std::move(later);
}

movers::MoversReport Session::LookForMovers(const image::Frame& frame,
                                            const FrameResult& result) {
  using movers::MoversState;
  if (localizer_ == nullptr) return mover_finder_.Skip(MoversState::kNoMap);
  if (!ground_is_known_) return mover_finder_.Skip(MoversState::kNoGround);
  const bool by_odometry = result.camera.state == CameraState::kOdometry;
  if (result.camera.state != CameraState::kTracked && !by_odometry) {
    return mover_finder_.Skip(MoversState::kNoPose);
  }
  if (!view_) return mover_finder_.Skip(MoversState::kNoGround);
  std::vector<Box2> targets_px;
  for (const TargetResult& target : result.targets) {
    if (target.box_px) targets_px.push_back(*target.box_px);
  }
  return mover_finder_.Process({frame.Pyramid(),
                                frame.capture_time,
                                &view_camera_,
                                view_->view.world_from_camera,
                                view_->pose_covariance,
                                by_odometry,
                                result.camera.reset_count,
                                ground_.get(),
                                targets_px});
}

absl::StatusOr<FrameResult> Session::ProcessFrame(
    const image::Frame& frame,
    const std::optional<CameraModel>& camera,
    const SensorReadings& sensors,
    std::vector<absl::Status>* target_errors) {
  const Clock::time_point start = Clock::now();
  const CameraModel frame_camera = camera.value_or(camera_);
  RETURN_IF_ERROR(CheckFrame(frame, frame_camera));
  FrameResult result;
  result.sequence = frame.sequence;
  result.capture_time = frame.capture_time;
  RETURN_IF_ERROR(Localize(frame, frame_camera, sensors, result));
  last_time_ = frame.capture_time;
  size_px_ = frame.size_px();
  SetView(result, frame_camera);
  const Clock::time_point localized = Clock::now();
  // A target that is marked anew in this frame starts over, or is gone.
  for (const PendingTarget& pending : pending_) {
    if (pending.frame_sequence.value_or(0) <= frame.sequence) {
      EraseTrack(pending.id);
    }
  }
  RETURN_IF_ERROR(TrackTargets(frame, result.targets));
  StartTargets(frame, result.targets, target_errors);
  const Clock::time_point tracked = Clock::now();
  if (options_.report_movers) result.movers = LookForMovers(frame, result);
  const Clock::time_point end = Clock::now();
  result.times.localize = localized - start;
  result.times.track = tracked - localized;
  result.times.movers = end - tracked;
  result.times.total = end - start;
  return result;
}

std::string Session::SaveCamera() const {
  return SaveSessionCamera({last_time_, hurried_}, localizer_.get());
}

absl::Status Session::RestoreCamera(std::string_view state) {
  if (last_time_) {
    return absl::FailedPreconditionError(
        "a session that has processed frames takes in no other one's camera");
  }
  ASSIGN_OR_RETURN(const SessionCamera camera,
                   RestoreSessionCamera(state, localizer_.get()));
  last_time_ = camera.last_time;
  hurried_ = camera.hurried;
  return absl::OkStatus();
}

absl::StatusOr<std::string> Session::SaveTargets() const {
  SessionTargets session{last_time_, size_px_, std::nullopt, pending_};
  if (view_) {
    session.view = {view_camera_,
                    view_->view.world_from_camera,
                    view_->pose_covariance,
                    view_->verified,
                    view_->reset_count};
  }
  return SaveSessionTargets(
      session, tracks_, standing_ ? &*standing_ : nullptr, options_);
}

absl::Status Session::RestoreTargets(std::string_view state) {
  if (!tracks_.empty() || !pending_.empty()) {
    return absl::FailedPreconditionError(
        "a session that has targets takes in no other one's");
  }
  ASSIGN_OR_RETURN(
      RestoredTargets restored,
      RestoreSessionTargets(
          state, options_, ground_, standing_ ? &*standing_ : nullptr));
  if (restored.session.last_time != last_time_) {
    return absl::FailedPreconditionError(
        "the session's targets are of another frame than its camera");
  }
  size_px_ = restored.session.size_px;
  pending_ = std::move(restored.session.pending);
  view_.reset();
  if (const auto& view = restored.session.view) {
    view_camera_ = view->camera;
    view_ = ViewFrom(view->world_from_camera);
    view_->pose_covariance = view->pose_covariance;
    view_->verified = view->verified;
    view_->reset_count = view->reset_count;
  }
  tracks_ = std::move(restored.tracks);
  if (standing_) standing_ = std::move(restored.standing);
  return absl::OkStatus();
}

}  // namespace

std::string TrackingSession::SaveCamera() const { return {}; }

absl::Status TrackingSession::RestoreCamera(std::string_view state) {
  if (state.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError("the session knows no camera");
}

absl::StatusOr<std::string> TrackingSession::SaveTargets() const {
  return std::string();
}

absl::Status TrackingSession::RestoreTargets(std::string_view state) {
  if (state.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError("the session knows no targets");
}

absl::StatusOr<std::unique_ptr<TrackingSession>> TrackingSession::Create(
    std::unique_ptr<localization::Localizer> localizer,
    std::shared_ptr<const ground::GroundSurface> ground,
    const CameraModel& camera,
    const SessionOptions& options,
    std::shared_ptr<const map::Map> map) {
  RETURN_IF_ERROR(options.Validate());
  // Unknown tracker names are told now, not in the first frame with a target.
  RETURN_IF_ERROR(target::CreateTargetTracker(options.tracker).status());
  return std::make_unique<Session>(
      std::move(localizer), std::move(ground), camera, options, std::move(map));
}

absl::StatusOr<std::unique_ptr<TrackingSession>> TrackingSession::Create(
    std::shared_ptr<const map::Map> map,
    const CameraModel& camera,
    const SessionOptions& options,
    localization::BackgroundRunner run_in_background) {
  RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<localization::Localizer> localizer;
  std::shared_ptr<const ground::GroundSurface> ground =
      ground::MakePlaneSurface({});
  if (map != nullptr) {
    ground = ground::SurfaceOf(*map);
    localization::LocalizerOptions localization = options.localization;
    localization.seed = base::MixSeed(options.seed, localization.seed);
    ASSIGN_OR_RETURN(
        localizer,
        localization::CreateLocalizer(options.localizer,
                                      map,
                                      localization,
                                      std::move(run_in_background)));
  }
  return Create(
      std::move(localizer), std::move(ground), camera, options, std::move(map));
}

}  // namespace groundlock::tracking
