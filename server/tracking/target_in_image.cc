// SPDX-License-Identifier: Apache-2.0
// How a target is looked for where the ground does not say where it is.
#include <cmath>

#include "map_store/base/status.h"
#include "server/tracking/association.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// There is nothing better to go by than the tracker itself: for so long a
// target is followed to where it looks most like itself, although it counts as
// not seen.
constexpr std::chrono::milliseconds kDoubt{500};
// It is learnt all the while, as the tracker's own gate allows, unless its
// motion says that it is rather something else.
constexpr double kBornOut = 0.5;
// A tracker finds a target less well the farther it is from where it looks, and
// learns it better the nearer (by 0.005 of AUC): it looks where the target was,
// unless that is farther from where it is expected than this, in its sides.
constexpr double kFarSides = 0.5;
// A prediction known to this share of the target's side says where to look.
constexpr double kKnownSigma = 0.5;
// Two boxes that overlap less are two places to look at.
constexpr double kSamePlace = 0.6;
// A find so far off the middle, in sides, is looked at again from there: the
// search's window has dimmed it.
constexpr double kOffMiddle = 0.25;
// Either axis of such a prediction is as uncertain.
Innovation InnovationOf(const ImageMotion::Prediction& predicted,
                        const Box2& found_px) {
  const double variance_px2 = predicted.covariance_px2(0, 0);
  return {
      .surprise = (found_px.center_px() - predicted.center_px).squaredNorm() /
                  variance_px2,
      .sigma_px2 = variance_px2};
}

}  // namespace

absl::StatusOr<TargetTrack::Look> TargetTrack::LookInImageAt(
    const Now& now,
    const Box2& box_px,
    const ImageMotion::Prediction& predicted,
    bool expects,
    bool doubted) {
  const cv::Size size_px = now.frame.size_px();
  Look look;
  if (!IsInView(box_px, size_px, kInViewShare)) return look;
  ASSIGN_OR_RETURN(look.observation,
                   Detect(now.frame,
                          box_px,
                          expects ? &predicted : nullptr,
                          /*fixed_size=*/ground_.has_value(),
                          now.hiding.left_out_px));
  if (!moved_) {
    look.motion_ratio =
        MotionRatio({.found_px = look.observation.box_px.center_px(),
                     .predicted_px = predicted.center_px,
                     .sigma_px = std::sqrt(predicted.covariance_px2(0, 0)),
                     .left_behind_px = image_motion_.LeftBehind_px(),
                     .side_px = image_motion_.side_px()});
    look.observation.confidence =
        Associate(look.observation.confidence, look.motion_ratio);
  }
  // Seen a moment ago, it does not go over to another one at once.
  look.another =
      frames_seen_ == 0 && !moved_ &&
      others_.IsTaken(
          look.observation.box_px,
          Likelihood(InnovationOf(predicted, look.observation.box_px)),
          now.around.taken);
  look.believed =
      !look.another &&
      (doubted ? look.observation.confidence : SurenessOf(look.observation)) >=
          options_->confidence_threshold &&
      IsInView(look.observation.box_px, size_px, kInViewShare);
  return look;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookInImage(const Now& now) {
  // Unseen for a while, it is by turns where it would be if it went on, and
  // where it was in the picture: what is carried with the background may have
  // been carried astray, and whoever films brings the target back.
  const bool unseen = frames_seen_ == 0 && time_ - last_seen_ > kDoubt;
  looks_in_image_ = unseen && !looks_in_image_;
  const ImageMotion::Prediction predicted = looks_in_image_
                                                ? image_motion_.UsualPlace()
                                                : image_motion_.Predict(time_);
  const Box2 predicted_px =
      Box2::FromCenter(predicted.center_px, box_px_.size_px());
  saliency_.Add(now.frame,
                background_.motion(),
                background_.is_known(),
                predicted_px,
                box_px_);
  const double side_px = image_motion_.side_px();
  const bool doubted = !ground_ && time_ - last_seen_ <= kDoubt;
  const bool is_far =
      image_motion_.IsBetterThanRest() &&
      (predicted.center_px - box_px_.center_px()).norm() > kFarSides * side_px;
  // Unseen, it goes on as it was going.
  const bool stays = moved_ || ((frames_seen_ > 0 || doubted) && !is_far);
  const Box2 place = stays ? box_px_ : predicted_px;
  const Box2 other = stays ? predicted_px : box_px_;
  // Which of the two it is, the first good look decides.
  const bool looks_twice =
      !moved_ && !ground_ && frames_seen_ == 0 &&
      image_motion_.LeftBehind_px() &&
      std::sqrt(predicted.covariance_px2(0, 0)) < kKnownSigma * side_px;
  Look look;
  if (looks_twice && doubted &&
      geometry::IntersectionOverUnion(place, other) < kSamePlace) {
    ASSIGN_OR_RETURN(
        look, LookInImageAt(now, other, predicted, /*expects=*/stays, doubted));
  }
  if (!look.believed) {
    const bool expects = !moved_ && (frames_seen_ > 0 || !stays);
    ASSIGN_OR_RETURN(look,
                     LookInImageAt(now, place, predicted, expects, doubted));
  }
  if (!ground_ && !moved_) {
    ASSIGN_OR_RETURN(look, LookAtMover(now, look, predicted));
  }
  if (!look.believed && doubted) FollowDoubted(now.frame, look);
  if (looks_twice && !look.believed && look.observation.confidence > 0.0 &&
      (look.observation.box_px.center_px() - place.center_px()).norm() >
          kOffMiddle * side_px) {
    ASSIGN_OR_RETURN(const Look again,
                     LookNearPrediction(now, look, predicted, doubted));
    if (again.believed) look = again;
  }
  if (look.believed && now.camera != nullptr && ground_) {
    look.sighting = ground_->Lift(*now.camera, look.observation.box_px);
  }
  if (look.believed || frames_seen_ > 0 || moved_) return look;
  const Now in_image{now.frame, nullptr, now.around, now.hiding};
  ASSIGN_OR_RETURN(const Look found, Search(in_image, predicted, std::nullopt));
  return found.believed ? found : look;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookNearPrediction(
    const Now& now,
    const Look& found,
    const ImageMotion::Prediction& predicted,
    bool doubted) {
  const Box2& box_px = found.observation.box_px;
  ASSIGN_OR_RETURN(
      Look look,
      LookInImageAt(now, box_px, predicted, /*expects=*/false, doubted));
  look.observation.confidence =
      AssociationProbability(look.observation.confidence,
                             InnovationOf(predicted, look.observation.box_px),
                             ReachArea_px2(box_px));
  look.believed = look.believed &&
                  look.observation.confidence >= options_->confidence_threshold;
  return look;
}

void TargetTrack::FollowDoubted(const image::Frame& frame, const Look& look) {
  const Box2& found_px = look.observation.box_px;
  // Nothing, if the place to look at is out of view or another target's.
  if (look.another || !(found_px.Area() > 0.0) ||
      !IsInView(found_px, frame.size_px(), kInViewShare)) {
    return;
  }
  box_px_ = found_px;
  if (look.motion_ratio >= kBornOut) Learn(frame, found_px);
}

}  // namespace groundlock::tracking
