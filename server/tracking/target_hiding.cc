// SPDX-License-Identifier: Apache-2.0
// What is believed and learnt of a target that something stands before.
#include <cmath>
#include <optional>
#include <utility>

#include "server/tracking/association.h"
#include "server/tracking/occlusion.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Outlines that overlap so much are the same for what hides them.
constexpr double kAsExpected = 0.9;
// A body is hidden for so long after points of it went over to what hides it.
constexpr std::chrono::milliseconds kHiddenStill{250};
// A target stands where it was seen for so long.
constexpr std::chrono::seconds kStands{1};
// Far behind the place where a target was last seen, of the side that it had
// there.
constexpr double kFarAway = 0.5;
// Landmarks of a wall may be so far apart that a smaller part of a picture
// shows too few of them (a wall of the rendered yards 8 m away: 12 in 40 by 40
// pixels, which hide a quarter of these).
constexpr double kLeastCover_px = 96.0;
// What overlaps another target so much, and the place where this one is
// expected less, is the other one.
constexpr double kOtherOverlap = 0.3;

}  // namespace

std::optional<ExpectedBody> TargetTrack::ExpectBody(
    const CameraView& camera, std::chrono::nanoseconds time) const {
  if (!ground_ || moved_) return std::nullopt;
  ExpectedBody body;
  body.id = id_;
  body.box_world = ground_->BoxAt(time);
  auto body_px = ground_->BodyInImage(camera, body.box_world);
  if (!body_px) return std::nullopt;
  body.body_px = *std::move(body_px);
  body.outline_px = body.body_px.Bounds();
  body.sigma_m = ground_->RangeSigma_m(camera);
  body.is_seen = frames_seen_ > 0;
  return body;
}

bool TargetTrack::IsKnownToStand(std::chrono::nanoseconds time) const {
  return time - last_seen_ <= kStands;
}

TargetTrack::Hiding TargetTrack::FindHiding(const CameraView* camera,
                                            const Surroundings& around) const {
  Hiding hiding;
  if (!around.may_hide || camera == nullptr) return hiding;
  const auto body = ExpectBody(*camera, time_);
  if (!body) return hiding;
  hiding.outline_px = body->outline_px;
  BoxCover cover(body->outline_px);
  for (const ExpectedBody& other : around.bodies) {
    if (others_.GoesWith(other.id)) continue;
    const bool is_before =
        StandsBefore(camera->view.world_from_camera.translation, other, *body);
    if (is_before) cover.Add(other.body_px);
    if (!is_before && !(other.is_seen && AreApart(other, *body))) continue;
    hiding.others_px.push_back(other.outline_px);
    // What stands behind this one is hidden by it where the two overlap.
    if (is_before ||
        Intersection(other.outline_px, body->outline_px).Area() == 0.0) {
      hiding.left_out_px.push_back(other.body_px);
    }
  }
  hiding.by_targets = cover.ShareOf(body->body_px);
  if (around.standing != nullptr) {
    cover.Add(around.standing->Before(camera->view, *body));
  }
  hiding.share = cover.ShareOf(body->body_px);
  return hiding;
}

bool TargetTrack::IsBehindMap(const Now& now, const Look& look) const {
  if (now.camera == nullptr || !now.around.may_hide ||
      now.around.standing == nullptr || !ground_ || !look.sighting) {
    return false;
  }
  ExpectedBody body;
  body.box_world = ground_->BodyAt(look.sighting->place_m);
  const auto outline = ground_->BodyHull(*now.camera, body.box_world);
  // What is known of the depth of landmarks tells nothing of places nearby.
  if (!outline || SideOf(*outline) > kFarAway * SideOf(box_px_)) {
    return false;
  }
  body.outline_px = Box2::FromCenter(
      outline->center_px(),
      outline->size_px().cwiseMax(Eigen::Vector2d::Constant(kLeastCover_px)));
  BoxCover cover(body.outline_px);
  cover.Add(now.around.standing->Before(now.camera->view, body));
  return cover.ShareOf(*outline) >= kMostlyHidden;
}

bool TargetTrack::IsAnotherTarget(const Now& now, const Look& look) const {
  const Box2& found_px = look.observation.box_px;
  // Of two that were both seen a moment ago none takes the other's place at
  // once: outlines below tell them apart.
  if (frames_seen_ == 0 && look.sighting &&
      others_.IsTaken(
          found_px, Likelihood(look.sighting->innovation), now.around.taken)) {
    return true;
  }
  for (const Box2& other_px : now.hiding.others_px) {
    const double overlap = geometry::IntersectionOverUnion(found_px, other_px);
    if (overlap > kOtherOverlap &&
        overlap >
            geometry::IntersectionOverUnion(found_px, now.hiding.outline_px)) {
      return true;
    }
  }
  return false;
}

bool TargetTrack::IsAnother(const Now& now, const Look& look) const {
  if (look.elsewhere) {
    return others_.IsTaken(
        look.observation.box_px, std::nullopt, now.around.taken);
  }
  if (IsAnotherTarget(now, look)) return true;
  // What is seen where it is not expected is not hidden by what is there.
  const bool is_there =
      geometry::Intersection(look.observation.box_px, now.hiding.outline_px)
          .Area() > 0.0;
  if (!is_there || hidden_.IsSeenInSpite(time_)) return false;
  return now.hiding.by_targets >= kMostlyHidden ||
         (now.hiding.share >= kMostlyHidden &&
          look.observation.confidence < SureConfidence());
}

bool TargetTrack::IsWhole(const Now& now) {
  // Where it was found, if that is not where it was expected.
  const auto body =
      now.camera != nullptr ? ExpectBody(*now.camera, time_) : std::nullopt;
  const bool as_expected =
      body && geometry::IntersectionOverUnion(
                  body->outline_px, now.hiding.outline_px) > kAsExpected;
  const Hiding hiding =
      as_expected ? now.hiding : FindHiding(now.camera, now.around);
  const bool is_whole = hidden_.IsWhole(
      hiding.by_targets, hiding.share, frames_seen_ <= 1, time_);
  // What stands before it need not be known: points of it went over to that.
  if (body_.last_hidden() && time_ - *body_.last_hidden() < kHiddenStill) {
    return false;
  }
  return is_whole;
}

}  // namespace groundlock::tracking
