// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/target_track.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "map_store/base/status.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Where a share of a target is hidden, what is seen of it, or what hides it,
// may be at either end of its box: a find's place is off by up to so much of
// the box, uniformly (1 / sqrt(12)).
constexpr double kHiddenSigma = 0.29;
// The hysteresis: a target that was not seen in the last frame must be surer by
// this share of what is left to certainty (0.65 for a threshold of 0.5), in one
// frame, or in frames in a row that together say as much.
constexpr double kAgainMargin = 0.3;
// A prediction whose two-sigma ellipse takes more looks than this to search
// leaves open where the target is.
constexpr double kVaguePlaces = 2.0;
// After it was hidden, the target must be seen for so many frames before it is
// learnt from: an occluder's edge may look right once.
constexpr int kFramesBeforeLearning = 2;
// What it looks like from a side is kept only if it was seen so long: by then
// its heading is known again.
constexpr int kFramesBeforeKeeping = 12;

}  // namespace

bool TargetTrack::IsInView(const Box2& box_px, cv::Size size, double share) {
  const Box2 image = Box2::FromXywh(0.0, 0.0, size.width, size.height);
  return Intersection(box_px, image).Area() >= share * box_px.Area();
}

TargetTrack::TargetTrack(std::string id, const SessionOptions& options)
    : id_(std::move(id)), options_(&options), views_(options.max_views) {}

absl::StatusOr<std::unique_ptr<TargetTrack>> TargetTrack::Start(
    const std::string& id,
    const image::Frame& frame,
    const CameraView* camera,
    const Box2& box_px,
    const SessionOptions& options,
    const std::optional<BodyKind>& kind) {
  std::unique_ptr<TargetTrack> track(new TargetTrack(id, options));
  track->told_kind_ = kind;
  ASSIGN_OR_RETURN(track->tracker_,
                   target::CreateTargetTracker(options.tracker));
  RETURN_IF_ERROR(track->tracker_->Initialize(frame.Bgr(), box_px));
  track->box_px_ = box_px;
  track->time_ = track->last_seen_ = frame.capture_time;
  track->frames_seen_ = kFramesBeforeLearning;
  track->last_recognized_ = frame.capture_time;
  track->image_motion_.Restart(box_px, frame.capture_time);
  // From this frame on.
  track->background_.Start(frame, camera);
  track->saliency_.Restart(frame, box_px);
  if (camera != nullptr && camera->verified) {
    auto ground = GroundTarget::Create(*camera,
                                       box_px,
                                       frame.capture_time,
                                       BoxCenter::kTexture,
                                       options.motion,
                                       kind);
    // Not on the ground (a bird, a box over the horizon): 2D only for now.
    if (ground.ok()) {
      track->ground_.emplace(*std::move(ground));
      track->ground_current_ = true;
      track->FollowTurn(camera);
      track->view_turn_.Learn(0.0);
      track->LearnBody(frame, *camera);
    }
  }
  return track;
}

TargetResult TargetTrack::StartResult(const CameraView* camera) const {
  return MakeResult(camera, 1.0);
}

std::optional<Box2> TargetTrack::ExpectedBox(
    const CameraView* camera, std::chrono::nanoseconds time) const {
  if (camera != nullptr && ground_ && !moved_) {
    return ground_->BodyHull(*camera, ground_->BoxAt(time));
  }
  return box_px_;
}

void TargetTrack::Move(const Box2& box_px) {
  box_px_ = box_px;
  moved_ = true;
}

std::optional<Box2> TargetTrack::SeenBox() const {
  if (frames_seen_ == 0) return std::nullopt;
  return box_px_;
}

absl::StatusOr<TargetResult> TargetTrack::Process(
    const image::Frame& frame,
    const CameraView* camera,
    const Surroundings& surroundings) {
  time_ = frame.capture_time;
  if (ground_) ground_->Predict(time_);
  FollowTurn(camera);
  RecallViews(camera);
  Now now{frame, camera, surroundings};
  FollowBody(now);
  now.hiding = FindHiding(camera, surroundings);
  silhouette_.Begin();
  if (camera != nullptr && frames_seen_ > 0 && silhouette_.IsDue(time_)) {
    MeasureSilhouette(now);
  }
  // The ground knows the place, unless the image does better: a held pose or a
  // time without one leaves the ground model behind what was seen since.
  const bool image_is_better =
      moved_ || (frames_seen_ > 0 &&
                 (!ground_current_ || camera == nullptr || !camera->verified));
  const bool from_ground = camera != nullptr && ground_ && !image_is_better;
  FollowBackground(now, from_ground);
  ASSIGN_OR_RETURN(Look look,
                   from_ground ? LookFromGround(now) : LookInImage(now));
  if (look.believed && from_ground && !look.by_body && frames_seen_ == 0 &&
      time_ - last_seen_ > kAbsent && !IsForetold(*camera, look)) {
    ASSIGN_OR_RETURN(const bool was_there, WasThereBefore(now, look));
    if (was_there) {
      look.believed = false;
      look.another = true;
      hypothesis_.reset();
      evidence_ = 0.0;
      lookalikes_.Add(look.sighting->place_m, time_);
    }
  }
  if (look.believed) {
    Believe(now, look);
    hidden_.NoteSeen();
  } else {
    frames_seen_ = 0;
    silhouette_.ForgetBeside();
    body_.Lose();
    KeepGroundWithout(now);
    hidden_.NoteUnseen(now.hiding.share);
  }
  moved_ = false;
  double confidence = look.observation.confidence;
  if (look.by_body) confidence = std::max(confidence, SureConfidence());
  if (look.by_motion) {
    confidence = std::max(confidence, options_->confidence_threshold);
  }
  if (look.another) {
    // However much it looks like the target.
    confidence = std::min(confidence, options_->confidence_threshold) *
                 (1.0 - now.hiding.share);
  }
  return MakeResult(camera, confidence);
}

void TargetTrack::FollowTurn(const CameraView* camera) {
  if (ImageTellsOutline()) turn_ = {};
  if (camera == nullptr || !camera->verified || !ground_ ||
      ImageTellsOutline()) {
    return;
  }
  const auto view = ground_->ViewOf(*camera);
  if (!view) return;
  view_turn_.Follow(*view);
  turn_ = ground_->TurnOf(*camera, view_turn_.angle_rad()).value_or(turn_);
}

bool TargetTrack::AsksForMotion(bool from_ground) const {
  return !from_ground || !ImageTellsOutline();
}

void TargetTrack::FollowBackground(const Now& now, bool from_ground) {
  if (AsksForMotion(from_ground)) {
    std::optional<geometry::Plane> ground_world;
    if (ground_) ground_world = ground_->tangent_world();
    background_.Follow(now.frame,
                       now.camera,
                       ground_world ? &*ground_world : nullptr,
                       box_px_);
  } else {
    background_.Skip(now.camera);
    saliency_ = MotionSaliency();
  }
  image_motion_.Carry(background_.motion());
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookFromGround(const Now& now) {
  const CameraView& camera = *now.camera;
  const cv::Size size_px = now.frame.size_px();
  Look look;
  const auto predicted = ground_->ProjectForTracker(camera);
  const auto covariance = ground_->ImageCovariance(camera);
  const double threshold = options_->confidence_threshold;
  const bool unseen = frames_seen_ == 0;
  const bool asks_motion = AsksForMotion(/*from_ground=*/true);
  if (asks_motion) {
    saliency_.Add(now.frame,
                  background_.motion(),
                  background_.is_known(),
                  predicted.value_or(box_px_),
                  box_px_);
  }
  // What was found in the frame before comes first: the prediction says less.
  const bool looks = !(hypothesis_ && hypothesis_->is_sure()) && predicted &&
                     IsInView(*predicted, size_px, kInViewShare);
  if (looks) {
    ASSIGN_OR_RETURN(look, LookAt(now, *predicted, threshold));
  }
  if (const auto beside = LookBeside(now, look)) return *beside;
  // Points of its body are surer than looks, and these than motion alone.
  look = LookAtRest(camera, look).value_or(look);
  look = LookInMotion(camera, look).value_or(look);
  if (!look.by_body) look = LookAtSilhouette(now, look).value_or(look);
  if (!look.by_body) look = LookAtPatches(now, look).value_or(look);
  if (look.by_body) return look;
  if (look.believed && IsKnownLookalike(look)) {
    look.believed = false;
    look.another = true;
  }
  if (looks) {
    if (asks_motion && covariance && !RestsByPoints()) {
      ASSIGN_OR_RETURN(
          look, LookAtMover(now, look, {predicted->center_px(), *covariance}));
      if (look.at_mover) return look;
    }
    if (look.believed && (!covariance || IsVague(*predicted, *covariance))) {
      evidence_ = 0.0;
      ASSIGN_OR_RETURN(look, LookAgain(now, look));
      if (hypothesis_ && hypothesis_->is_sure()) return look;
    } else if (look.believed && unseen) {
      const double again = threshold + kAgainMargin * (1.0 - threshold);
      evidence_ += LogOdds(look.observation.confidence) - LogOdds(threshold);
      look.believed = evidence_ >= LogOdds(again) - LogOdds(threshold);
      return look;
    }
  }
  if (!unseen || look.believed) return look;
  evidence_ = 0.0;
  // What goes on in the image as the target did, but not where the ground has
  // that, may be it all the same: the ground may be wrong. Unless something is
  // known to hide it.
  std::optional<Box2> beside_px;
  if (looks && !look.another && !hidden_.vanished_behind() &&
      now.hiding.share == 0.0 &&
      (!look.sighting || look.sighting->innovation.surprise > kGate) &&
      GoesOnInImage(look.observation.box_px)) {
    beside_px = look.observation.box_px;
  }
  std::optional<ImageMotion::Prediction> expected;
  // It is searched for because something went otherwise than was foreseen.
  const auto anywhere_px2 = ground_->ImageCovariance(
      camera, std::chrono::duration<double>(time_ - last_seen_).count());
  if (predicted && anywhere_px2) {
    expected = {predicted->center_px(), *anywhere_px2};
  }
  ASSIGN_OR_RETURN(const Look found, Search(now, expected, beside_px));
  return found.believed || hypothesis_ ? found : look;
}

bool TargetTrack::IsForetold(const CameraView& camera, const Look& look) const {
  if (look.elsewhere) return false;
  const auto predicted = ground_->ProjectForTracker(camera);
  const auto covariance = ground_->ImageCovariance(camera);
  return predicted && covariance && !IsVague(*predicted, *covariance);
}

bool TargetTrack::GoesOnInImage(const Box2& found_px) const {
  const ImageMotion::Prediction expected = image_motion_.Predict(time_);
  const Eigen::Vector2d off_px = found_px.center_px() - expected.center_px;
  return off_px.dot(expected.covariance_px2.ldlt().solve(off_px)) <= kGate;
}

bool TargetTrack::ImageTellsOutline() const {
  return ground_ && ground_->has_own_outline() && tracker_->SeesSize();
}

double TargetTrack::ReachArea_px2(const Box2& box_px) const {
  return std::numbers::pi * tracker_->Reach(box_px).prod();
}

bool TargetTrack::IsVague(const Box2& predicted_px,
                          const Eigen::Matrix2d& covariance_px2) const {
  const double places = std::numbers::pi *
                        std::sqrt(covariance_px2.determinant()) /
                        tracker_->Reach(predicted_px).prod();
  return !(places <= kVaguePlaces);
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookAgain(const Now& now,
                                                         const Look& found) {
  ASSIGN_OR_RETURN(Look again,
                   LookFor(now, found.observation.box_px, SureConfidence()));
  if (again.believed && frames_seen_ == 0) Suppose(again);
  return again;
}

absl::StatusOr<target::TargetObservation> TargetTrack::Detect(
    const image::Frame& frame,
    const Box2& box_px,
    const ImageMotion::Prediction* expected,
    bool fixed_size,
    std::span<const geometry::ConvexPolygon> left_out_px) {
  picture_.Show(frame, *tracker_, box_px, turn_);
  const Box2 there_px = picture_.ToTracker(box_px);
  tracker_->Place(there_px);
  if (expected != nullptr) {
    tracker_->Expect(picture_.ToTracker(expected->center_px),
                     picture_.ToTracker(expected->covariance_px2));
  }
  std::vector<geometry::ConvexPolygon> left_out(left_out_px.begin(),
                                                left_out_px.end());
  for (geometry::ConvexPolygon& part : left_out) {
    for (Eigen::Vector2d& corner_px : part.corners_px) {
      corner_px = picture_.ToTracker(corner_px);
    }
  }
  tracker_->LeaveOut(left_out);
  tracker_->Recall(recalled_);
  ASSIGN_OR_RETURN(
      target::TargetObservation seen,
      tracker_->Detect(picture_.Within(frame, tracker_->DetectBox(there_px)),
                       fixed_size));
  seen.box_px = picture_.FromTracker(seen.box_px);
  return seen;
}

void TargetTrack::RecallViews(const CameraView* camera) {
  // A hypothesis is looked at again by what made it.
  if (hypothesis_ && hypothesis_->is_sure()) return;
  recalled_.clear();
  if (!ground_ || frames_seen_ > 0) return;
  std::optional<double> view_rad;
  if (camera != nullptr) view_rad = ground_->ViewAngle_rad(*camera);
  recalled_ = views_.Recall(view_rad, time_ - last_seen_);
}

void TargetTrack::RememberView(const CameraView& camera, double confidence) {
  if (frames_seen_ < kFramesBeforeKeeping || !ground_ || !ground_current_ ||
      !camera.verified || confidence < SureConfidence()) {
    return;
  }
  views_.Remember(ground_->ViewAngle_rad(camera), time_, *tracker_);
}

void TargetTrack::Learn(const image::Frame& frame, const Box2& box_px) {
  if (!IsInView(box_px, frame.size_px(), kLearnShare) ||
      !picture_.Holds(frame, box_px)) {
    return;
  }
  tracker_->Learn(
      picture_.Within(frame, tracker_->LearnBox(picture_.ToTracker(box_px))));
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookAt(const Now& now,
                                                      const Box2& box_px,
                                                      double min_confidence) {
  std::vector<geometry::ConvexPolygon> left_out_px = now.hiding.left_out_px;
  ASSIGN_OR_RETURN(const Look look,
                   LookPast(now, box_px, min_confidence, left_out_px));
  if (look.believed) return look;
  if (!left_out_px.empty() && now.hiding.by_targets < kMostlyHidden) {
    // What stands before it may be elsewhere, or smaller, than it is taken to
    // be.
    ASSIGN_OR_RETURN(const Look all_of_it,
                     LookPast(now, box_px, min_confidence, {}));
    if (all_of_it.believed) return all_of_it;
  }
  if (look.sighting && look.sighting->innovation.surprise > kGate &&
      look.looks >= min_confidence) {
    // What looks like it where it cannot be is another one, and hides from the
    // tracker what is left if that is taken out.
    const Box2& found_px = look.observation.box_px;
    left_out_px.push_back({{found_px.min_px,
                            {found_px.max_px.x(), found_px.min_px.y()},
                            found_px.max_px,
                            {found_px.min_px.x(), found_px.max_px.y()}}});
    ASSIGN_OR_RETURN(const Look rest,
                     LookPast(now, box_px, min_confidence, left_out_px));
    if (rest.believed) return rest;
  }
  return look;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookPast(
    const Now& now,
    const Box2& box_px,
    double min_confidence,
    std::span<const geometry::ConvexPolygon> left_out_px) {
  const CameraView& camera = *now.camera;
  Look look;
  const auto covariance = ground_->ImageCovariance(camera);
  ImageMotion::Prediction expected;
  if (covariance) expected = {box_px.center_px(), *covariance};
  const bool free_size = frames_seen_ > 0 && ImageTellsOutline();
  const Box2 place_px =
      free_size ? Box2::FromCenter(box_px.center_px(), box_px_.size_px())
                : box_px;
  ASSIGN_OR_RETURN(look.observation,
                   Detect(now.frame,
                          place_px,
                          covariance ? &expected : nullptr,
                          /*fixed_size=*/!free_size,
                          left_out_px));
  look.looks = look.observation.confidence;
  look.sighting = ground_->Lift(
      camera, look.observation.box_px, kHiddenSigma * now.hiding.share);
  if (look.sighting) {
    look.observation.confidence = AssociationProbability(
        look.looks, look.sighting->innovation, ReachArea_px2(box_px));
  }
  look.another = IsAnother(now, look);
  look.believed =
      !look.another && look.observation.confidence >= min_confidence &&
      look.sighting && look.sighting->innovation.surprise <= kGate &&
      IsInView(look.observation.box_px, now.frame.size_px(), kInViewShare);
  return look;
}

void TargetTrack::FollowGrowth(const image::Frame& frame,
                               const CameraView& camera) {
  const auto size_px = ground_->SeenSize_px(camera);
  if (!size_px || !IsInView(box_px_, frame.size_px(), kLearnShare)) return;
  if (ImageTellsOutline()) {
    ground_->FollowSize(camera, box_px_.size_px());
    return;
  }
  if (!picture_.Holds(frame, box_px_)) return;
  const auto growth = tracker_->MeasureGrowth(
      picture_.Within(frame, tracker_->DetectBox(picture_.ToTracker(box_px_))),
      picture_.ToTracker(Box2::FromCenter(box_px_.center_px(), *size_px)));
  if (growth) ground_->FollowGrowth(camera, *growth);
}

bool TargetTrack::UpdateGround(const Now& now,
                               const Look& look,
                               bool was_current) {
  ground_current_ = false;
  if (now.camera == nullptr) return false;
  const CameraView& camera = *now.camera;
  std::optional<GroundSighting> sighting = look.sighting;
  if (ground_ && sighting && frames_seen_ == 1) {
    // Seen from another side, another point of it is followed.
    ground_->FollowView(camera, /*learns=*/false);
    sighting = ground_->LiftAsLarge(camera, box_px_);
  }
  if (ground_ && sighting) {
    if (was_current) {
      ground_->Update(camera, *sighting);
    } else {
      ground_->Restart(*sighting);
    }
    ground_current_ = true;
    return false;
  }
  if (ground_ || !camera.verified) return false;
  // It gets its ground in this frame, as in that in which it was drawn.
  auto ground = GroundTarget::Create(camera,
                                     box_px_,
                                     time_,
                                     BoxCenter::kTexture,
                                     options_->motion,
                                     told_kind_);
  if (!ground.ok()) return false;
  ground_.emplace(*std::move(ground));
  ground_current_ = true;
  return true;
}

void TargetTrack::Believe(const Now& now, const Look& look) {
  box_px_ = look.observation.box_px;
  ++frames_seen_;
  evidence_ = 0.0;
  last_seen_ = time_;
  hypothesis_.reset();
  if (moved_) saliency_.Restart(now.frame, box_px_);
  saliency_.Mark(box_px_);
  if (!look.by_motion) {
    last_recognized_ = time_;
    saliency_.Learn(box_px_);
  }
  if (moved_ || (look.elsewhere && !look.at_mover)) {
    image_motion_.Restart(box_px_, time_);
  } else {
    image_motion_.Update(
        box_px_,
        time_,
        look.by_body ? SureConfidence() : look.observation.confidence,
        !look.by_motion);
  }
  const bool was_current = ground_current_ && !moved_ && !look.elsewhere;
  const bool is_first = UpdateGround(now, look, was_current);
  others_.Note(box_px_, now.around.taken);
  tracker_->Adopt();
  const bool whole = IsWhole(now);
  const bool learns =
      whole && frames_seen_ >= kFramesBeforeLearning && !look.by_motion;
  if (ground_current_) {
    const CameraView& camera = *now.camera;
    if (whole && was_current) FollowGrowth(now.frame, camera);
    ground_->FollowView(camera, learns);
    if (whole && was_current && silhouette_.seen()) {
      body_.ShiftPoints(
          -silhouette_.Teach(camera, box_px_, look.by_body, time_, *ground_));
    } else if (!was_current) {
      silhouette_.ForgetBefore();
    }
    if (whole && (was_current || is_first) && camera.verified) {
      LearnBody(now.frame, camera);
    }
  }
  if (learns) LearnLooks(now, look.observation.confidence);
}

void TargetTrack::LearnLooks(const Now& now, double confidence) {
  Learn(now.frame, box_px_);
  // What it looked like before an absence is not learnt over at once.
  view_turn_.Learn(
      frames_seen_ > kFramesBeforeLearning
          ? std::chrono::duration<double>(time_ - last_learnt_).count()
          : 0.0);
  last_learnt_ = time_;
  if (now.camera == nullptr) return;
  if (frames_seen_ >= kFramesBeforeKeeping && now.camera->verified &&
      confidence >= SureConfidence()) {
    earlier_frames_.Keep(now.frame, *now.camera, box_px_);
  }
  RememberView(*now.camera, confidence);
  RememberPatches(now.frame, *now.camera, confidence);
}

TargetResult TargetTrack::MakeResult(const CameraView* camera,
                                     double confidence) const {
  TargetResult result;
  result.id = id_;
  result.confidence = std::clamp(confidence, 0.0, 1.0);
  result.age = time_ - last_seen_;
  if (frames_seen_ > 0) {
    result.state = TargetState::kTracked;
    // The tracker's box is about the texture it follows; the body's outline
    // stands about it as the ground model says.
    const auto outline =
        camera != nullptr && ground_ && ground_current_ && !ImageTellsOutline()
            ? ground_->ProjectAbout(*camera, box_px_.center_px())
            : std::nullopt;
    result.box_px = outline.value_or(box_px_);
  } else {
    result.state = result.age > options_->target_lost_after
                       ? TargetState::kLost
                       : TargetState::kPredicted;
    if (camera != nullptr && ground_) {
      result.box_px = ground_->Project(*camera);
    } else {
      result.box_px = box_px_;
    }
  }
  if (camera != nullptr && ground_) {
    result.box_world = ground_->box();
    result.ground_covariance_m2 = ground_->ground_covariance_m2();
    result.heading_sigma_rad = ground_->HeadingSigma_rad();
    result.front_known = ground_->front_known();
    if (ground_->kind() != nullptr) result.body_kind = ground_->kind()->name;
    result.size_covariance_m2 = ground_->SizeCovariance_m2();
    result.velocity_world_m_s = ground_->velocity_world_m_s();
  }
  return result;
}

}  // namespace groundlock::tracking
