// SPDX-License-Identifier: Apache-2.0
// When what moves against the background is the target, whatever it looks like
// (docs/method.md, "What moves").
#include <algorithm>
#include <cmath>

#include "map_store/base/status.h"
#include "server/tracking/association.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// What was found instead has stayed with the background if so much less moves
// there, so many sides away, and it has gone so much less.
constexpr double kStays = 0.4;
constexpr double kStaysSides = 0.3;
constexpr double kRestSides = 0.3;  // a second
// Of velocities: 95 %.
constexpr double kSigmas = 2.0;
// Share of its box in the image from which it is seen whole.
constexpr double kWholeShare = 0.95;
// What moves is taken to tell the place so well, in sides: it is but a part of
// the target. And where all of it would be seen. Neither was measured apart
// from the runs in docs/method.md.
constexpr double kMoverSigma = 0.25;
constexpr double kWholeSigma = 0.1;
// From so much on that the map hides of a target, a part of it is seen.
constexpr double kPartHidden = 0.2;
// Then not as many movers as come in that time are worth more than one (as of
// silhouettes).
constexpr double kMoverTime_s = 1.0;
// Squared Mahalanobis distance; chi-square, 2 degrees, 95 %.
constexpr double kMoverGate = 6.0;
// And it goes on as the target did: to a share of its velocity, and so many
// sides a second.
constexpr double kVelocityShare = 0.5;
constexpr double kVelocitySides = 0.5;
// It tells the velocity to a share of it (one sigma: 14 to 22 px/s of 17 as
// uavdt_s1606 passes its lamp).
constexpr double kVelocityError = 0.25;
// What is so many times as large or small at once is at another distance: past
// the crest of a hill the ground goes on far behind.
constexpr double kMostGrowth = 1.4;
// For so long what moves is the target whatever it looks like.
constexpr std::chrono::milliseconds kMotionAlone{2'000};

// Where trace and prediction put it together; nullopt: they contradict each
// other.
std::optional<ImageMotion::Prediction> Together(
    const ImageMotion::Prediction& trace,
    const ImageMotion::Prediction& predicted) {
  const double trace_px2 = trace.covariance_px2(0, 0);
  const double predicted_px2 =
      std::sqrt(predicted.covariance_px2.determinant());
  const Eigen::Vector2d off_px = trace.center_px - predicted.center_px;
  if (off_px.squaredNorm() > kMoverGate * (predicted_px2 + trace_px2)) {
    return std::nullopt;
  }
  const double gain = predicted_px2 / (predicted_px2 + trace_px2);
  return ImageMotion::Prediction{
      predicted.center_px + gain * off_px,
      gain * trace_px2 * Eigen::Matrix2d::Identity()};
}

}  // namespace

bool TargetTrack::MeetsAnother(const Now& now, const Box2& box_px) {
  const auto meets = [&](const Box2& other_px) {
    return Intersection(box_px, other_px).Area() > 0.0;
  };
  return std::any_of(
             now.around.taken.begin(),
             now.around.taken.end(),
             [&](const SeenTarget& other) { return meets(other.box_px); }) ||
         std::any_of(now.around.bodies.begin(),
                     now.around.bodies.end(),
                     [&](const ExpectedBody& other) {
                       return meets(other.outline_px);
                     });
}

bool TargetTrack::LooksAsLarge(const CameraView& camera,
                               const GroundSighting& sighting) const {
  const auto before_px = ground_->BodyHull(camera, ground_->box());
  const auto after_px =
      ground_->BodyHull(camera, ground_->BodyAt(sighting.place_m));
  if (!before_px || !after_px) return false;
  const double growth = std::sqrt(after_px->Area() / before_px->Area());
  return std::max(growth, 1.0 / growth) <= kMostGrowth;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookAtMover(
    const Now& now,
    const Look& found,
    const ImageMotion::Prediction& predicted) {
  const CameraView* camera = ground_ ? now.camera : nullptr;
  if (time_ - last_seen_ > kMotionAlone) return found;
  const double side_px = image_motion_.side_px();
  const auto mover = saliency_.spot();
  // What comes from where two were is either of them.
  if (MeetsAnother(now, box_px_) ||
      (mover && MeetsAnother(now, mover->box_px))) {
    last_met_another_ = time_;
  }
  const bool is_either =
      last_met_another_ && time_ - *last_met_another_ < kMotionAlone;
  // What leaves the picture moves no more there.
  const auto is_whole = [&](const Eigen::Vector2d& center_px) {
    return IsInView(Box2::FromCenter(center_px, box_px_.size_px()),
                    now.frame.size_px(),
                    kWholeShare);
  };
  if (!mover || is_either || !is_whole(mover->box_px.center_px()) ||
      !is_whole(predicted.center_px)) {
    return found;
  }
  const double sigma = mover->is_whole ? kWholeSigma : kMoverSigma;
  ImageMotion::Prediction there{
      mover->box_px.center_px(),
      std::pow(sigma * side_px, 2) * Eigen::Matrix2d::Identity()};
  const auto off_sides = [&](const Box2& box_px) {
    return (box_px.center_px() - there.center_px).norm() / side_px;
  };
  // Looks have stayed with the background, whether they still say so or not.
  const ImageMotion::Velocity looks =
      found.believed ? image_motion_.LooksOverBackground(
                           found.observation.box_px.center_px(), time_)
                     : image_motion_.LooksOverBackground();
  const bool stayed =
      looks.px_s.norm() < std::min(kStays * mover->velocity_px_s.norm(),
                                   kRestSides * side_px) &&
      !(camera != nullptr &&
        ground_->GoesOverGround(
            *camera, looks.px_s, kSigmas * looks.sigma_px_s, kRestSides));
  bool elsewhere = found.believed;
  if (found.believed) {
    const auto moves = saliency_.ShareAt(found.observation.box_px);
    if (!moves || *moves >= kStays * mover->share ||
        off_sides(found.observation.box_px) <= kStaysSides || !stayed) {
      return found;
    }
  } else {
    // A part of what the map hides is enough to keep it, not to find it again.
    if (now.hiding.share >= kPartHidden && frames_seen_ == 0) return found;
    const Eigen::Vector2d velocity_px_s = image_motion_.OverBackground_px_s();
    const bool goes_on_alike =
        (mover->velocity_px_s - velocity_px_s).norm() <=
        kVelocityShare * velocity_px_s.norm() + kVelocitySides * side_px;
    const auto both = Together(there, predicted);
    if (goes_on_alike && both) {
      there = *both;
    } else if (stayed && (there.center_px - predicted.center_px).norm() >
                             kStaysSides * side_px) {
      elsewhere = true;
    } else {
      return found;
    }
  }
  const Box2 there_px =
      Box2::FromCenter(there.center_px, mover->box_px.size_px());
  ASSIGN_OR_RETURN(Look look,
                   LookInImageAt(now,
                                 there_px,
                                 there,
                                 /*expects=*/true,
                                 /*doubted=*/true));
  if (look.another) return found;
  if (!look.believed || off_sides(look.observation.box_px) > kStaysSides) {
    if (time_ - last_recognized_ > kMotionAlone || !mover->has_gone_on) {
      return found;
    }
    look.observation.box_px = there_px;
    look.believed = look.by_motion = true;
  }
  look.at_mover = true;
  if (camera == nullptr) return look;
  // Of what the map hides a part of, the same part is seen for a while.
  const double step_s =
      std::chrono::duration<double>(time_ - last_seen_).count();
  const double times =
      now.hiding.share >= kPartHidden
          ? std::sqrt(std::max(1.0, kMoverTime_s / std::max(step_s, 1e-3)))
          : 1.0;
  look.sighting = look.by_motion
                      ? ground_->Lift(*camera, mover->box_px, times * sigma)
                      : ground_->Lift(*camera, look.observation.box_px);
  if (!look.sighting || IsAnotherTarget(now, look) ||
      !LooksAsLarge(*camera, *look.sighting)) {
    return found;
  }
  // Where it was followed to was the background.
  look.elsewhere = elsewhere;
  if (elsewhere) {
    ground_->TellVelocity(*camera,
                          mover->velocity_px_s,
                          kVelocityError * mover->velocity_px_s.norm(),
                          *look.sighting);
  }
  return look;
}

}  // namespace groundlock::tracking
