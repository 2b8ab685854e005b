// SPDX-License-Identifier: Apache-2.0
// Points of a target's body tell what it is like and, of one that has not moved
// since it was marked, that it is still there (docs/method.md, "A body at rest"
// and "A body in motion").
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>
#include <vector>

#include "server/tracking/body_size.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// A body at rest is not found farther from where it is, of its size: where
// else it seems to be is something else.
constexpr double kAtRest = 0.2;
// Where more of the target is hidden, a silhouette is not all of it.
constexpr double kHiddenOfSilhouette = 0.05;
// Unseen for so long, a target that something hid is behind it.
constexpr std::chrono::seconds kGone{1};
// What moves where a target was seen no longer ago is the target.
constexpr std::chrono::milliseconds kSilhouetteAlone{500};

}  // namespace

void TargetTrack::FollowBody(const Now& now) {
  const CameraView* camera = now.camera;
  const auto outline_px = camera != nullptr && camera->verified &&
                                  frames_seen_ > 0 && ground_ &&
                                  ground_current_ && !moved_
                              ? ground_->Project(*camera)
                              : std::nullopt;
  if (outline_px) {
    body_.Follow(
        now.frame, *camera, *outline_px, ground_->MotionSince(last_seen_));
  } else {
    body_.Lose();
  }
}

void TargetTrack::MeasureSilhouette(const Now& now) {
  if (!now.camera->verified || !ground_ || !ground_current_ || moved_ ||
      !ground_->has_moved() || !ground_->is_rigid() ||
      now.hiding.share > kHiddenOfSilhouette) {
    return;
  }
  silhouette_.Measure(
      now.frame, *now.camera, *ground_, [&](const Box2& box_px) {
        return MeetsAnother(now, box_px);
      });
}

void TargetTrack::KeepGroundWithout(const Now& now) {
  if (!options_->follow_bodies || now.camera == nullptr ||
      !now.camera->verified || !ground_ || time_ - last_seen_ < kGone) {
    return;
  }
  // Where nothing hid it, it may be there and not be recognised.
  const Box2 about_px = ground_->Project(*now.camera).value_or(box_px_);
  if (!hidden_.vanished_behind() &&
      IsInView(about_px, now.frame.size_px(), kInViewShare)) {
    return;
  }
  silhouette_.KeepWithout(now.frame, *now.camera, about_px);
}

std::optional<TargetTrack::Look> TargetTrack::LookBeside(const Now& now,
                                                         const Look& look) {
  const auto beside = silhouette_.Beside();
  if (!beside) return std::nullopt;
  auto there =
      LookBySilhouette(now, *beside, GroundTarget::Whereabouts::kUnknown, look);
  if (!there) return std::nullopt;
  there->elsewhere = true;
  silhouette_.ForgetBeside();
  return there;
}

std::optional<TargetTrack::Look> TargetTrack::LookBySilhouette(
    const Now& now,
    const ground::SeenOutline& silhouette,
    GroundTarget::Whereabouts whereabouts,
    const Look& look) {
  Look there = look;
  there.sighting = ground_->SightBySilhouette(
      *now.camera, silhouette, whereabouts, there.observation.box_px);
  if (!there.sighting || IsAnotherTarget(now, there)) return std::nullopt;
  there.believed = there.by_body = true;
  there.another = there.elsewhere = false;
  PlaceTracker(there.observation.box_px);
  return there;
}

void TargetTrack::LearnBody(const image::Frame& frame,
                            const CameraView& camera) {
  if (!options_->follow_bodies) return;
  const auto outline_px = ground_->ProjectAbout(camera, box_px_.center_px());
  if (outline_px) {
    silhouette_.Keep(frame, camera, *outline_px, ground_->box());
  }
  // Of one that moves and is no rigid body points tell nothing.
  if (!outline_px || (ground_->has_moved() && !ground_->is_rigid())) {
    body_.End();
    return;
  }
  const bool is_view =
      body_.Observe(frame,
                    camera,
                    *outline_px,
                    silhouette_.seen(),
                    {.box_world = ground_->box(),
                     .rests = ground_->BodyAtRest().has_value(),
                     .moves = ground_->has_moved(),
                     .heading_known = ground_->heading_known(),
                     .ground_world = ground_->ground_as_known(),
                     .ground_sigmas = ground_->ground_sigmas()});
  if (!is_view || !body_.HasNews()) return;
  if (!ground_->has_moved()) {
    ground_->FitBody(camera, body_.Points());
  } else {
    const BodyFollower::Tracks tracks = body_.TracksOfMotion();
    const auto found = ground_->FitMovingBody(camera, tracks);
    if (found) {
      body_.Refine(tracks, *found);
      silhouette_.ForgetBefore();
    }
  }
  // Points are looked for where they were on the outline; it has changed, but
  // not because they moved.
  const auto fitted_px = ground_->ProjectAbout(camera, box_px_.center_px());
  if (fitted_px) body_.SetOutline(*fitted_px);
}

bool TargetTrack::RestsByPoints() const {
  const auto body = ground_->BodyAtRest();
  return body && body_.IsSeenAtRest(*body);
}

std::optional<TargetTrack::Look> TargetTrack::LookAtRest(
    const CameraView& camera, const Look& look) {
  const auto expected_px = ground_->ProjectForTracker(camera);
  if (!expected_px || !RestsByPoints()) return std::nullopt;
  const Eigen::Vector2d aside =
      (look.observation.box_px.center_px() - expected_px->center_px())
          .cwiseQuotient(expected_px->size_px());
  if (look.believed && aside.norm() < kAtRest) return std::nullopt;
  Look at_rest = look;
  at_rest.sighting = ground_->StayAtRest(camera, at_rest.observation.box_px);
  if (!at_rest.sighting) return std::nullopt;
  at_rest.believed = true;
  at_rest.another = at_rest.elsewhere = false;
  at_rest.by_body = true;
  PlaceTracker(at_rest.observation.box_px);
  return at_rest;
}

std::optional<TargetTrack::Look> TargetTrack::LookInMotion(
    const CameraView& camera, const Look& look) {
  const auto seen = body_.SightingsInMotion();
  // Too few to say anything.
  if (seen.size() < GroundTarget::kMinAgreeing) return std::nullopt;
  Look in_motion = look;
  std::vector<bool> agrees;
  in_motion.sighting = ground_->SightByPoints(
      camera,
      seen,
      look.believed ? std::optional(look.observation.box_px.center_px())
                    : std::nullopt,
      in_motion.observation.box_px,
      agrees);
  if (!in_motion.sighting) return std::nullopt;
  body_.KeepAgreeing(agrees);
  in_motion.believed = true;
  in_motion.another = in_motion.elsewhere = false;
  in_motion.by_body = true;
  PlaceTracker(in_motion.observation.box_px);
  return in_motion;
}

std::optional<TargetTrack::Look> TargetTrack::LookAtSilhouette(
    const Now& now, const Look& look) {
  if (look.believed || time_ - last_seen_ > kSilhouetteAlone) {
    return std::nullopt;
  }
  MeasureSilhouette(now);
  if (!silhouette_.seen()) return std::nullopt;
  return LookBySilhouette(
      now, *silhouette_.seen(), GroundTarget::Whereabouts::kExpected, look);
}

void TargetTrack::RememberPatches(const image::Frame& frame,
                                  const CameraView& camera,
                                  double confidence) {
  if (!options_->follow_bodies || !ground_ || !ground_current_ ||
      !camera.verified || ImageTellsOutline() ||
      confidence < SureConfidence()) {
    return;
  }
  const auto outline_px = ground_->ProjectAbout(camera, box_px_.center_px());
  if (outline_px) {
    patches_.Keep(
        frame, camera, ground_->box(), *outline_px, ground_->unturned_rad());
  }
}

std::optional<TargetTrack::Look> TargetTrack::LookAtPatches(const Now& now,
                                                            const Look& look) {
  const CameraView& camera = *now.camera;
  if (look.believed || look.another || !camera.verified ||
      ImageTellsOutline() || now.hiding.by_targets >= kMostlyHidden ||
      !patches_.AreKnownIn(ground_->unturned_rad())) {
    return std::nullopt;
  }
  const auto expected_px = ground_->ProjectForTracker(camera);
  if (!expected_px) return std::nullopt;
  const bool is_found =
      look.sighting && look.sighting->innovation.surprise <= kGate;
  const bool rests = !ground_->has_moved();
  std::vector<geometry::Box3> places = {ground_->box()};
  if (!rests && is_found) {
    places.push_back(ground_->BodyAt(look.sighting->place_m));
  }
  std::optional<PatchMemory::Match> best;
  geometry::Box3 best_place;
  for (const geometry::Box3& place : places) {
    auto match = patches_.Find(now.frame, camera, place, rests);
    if (match && (!best || match->patches.size() > best->patches.size())) {
      best = std::move(match);
      best_place = place;
    }
  }
  if (!best) return std::nullopt;
  Look there = look;
  Box2& box_px = there.observation.box_px;
  const cv::Size size_px = now.frame.size_px();
  // Of one at rest, looks say where the tracker's point of it is by now, if
  // they go with its patches.
  const bool looks_agree = rests && is_found &&
                           IsInView(box_px, size_px, kLearnShare) &&
                           (box_px.center_px() - expected_px->center_px())
                                   .cwiseQuotient(box_px.size_px())
                                   .norm() < kAtRest;
  if (!rests) {
    there.sighting = ground_->SightByPatches(camera, best_place, *best, box_px);
    if (!there.sighting) return std::nullopt;
  } else if (best->shift_px.norm() > kAtRest * std::sqrt(expected_px->Area())) {
    return std::nullopt;
  } else if (!looks_agree) {
    there.sighting.reset();
    box_px = *expected_px;
  }
  if (!IsInView(box_px, size_px, kInViewShare) || IsAnotherTarget(now, there) ||
      others_.IsTaken(box_px, std::nullopt, now.around.taken)) {
    return std::nullopt;
  }
  if (rests && !looks_agree) {
    there.sighting = ground_->StayByPatches(camera, box_px);
    if (!there.sighting) return std::nullopt;
  } else if (!rests) {
    ground_->KeepView(camera);
  }
  there.believed = there.by_body = true;
  there.another = there.elsewhere = false;
  PlaceTracker(box_px);
  return there;
}

void TargetTrack::PlaceTracker(const Box2& box_px) {
  tracker_->Place(picture_.ToTracker(box_px));
}

}  // namespace groundlock::tracking
