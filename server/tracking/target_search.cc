// SPDX-License-Identifier: Apache-2.0
// How a target that is not where it was predicted is found again.
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "map_store/base/status.h"
#include "server/image/colour_picture.h"
#include "server/tracking/body_size.h"
#include "server/tracking/likely_places.h"
#include "server/tracking/search_places.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Away from the predicted place a target must be surer by this share of what is
// left to certainty (0.8 for a threshold of 0.5): more places looked at give
// more chances to be wrong.
constexpr double kSearchMargin = 0.6;
// Unseen for so long it may be anywhere in the image: soon where the camera's
// motion is not known, later where the ground says where it should be, for what
// looks like it elsewhere is rather its twin.
constexpr std::chrono::milliseconds kSearchImageAfter{500};
constexpr std::chrono::milliseconds kSearchGroundAfter{2'000};
// What was there before was on the ray on which it is now, by so many sizes:
// things that stood still were found within 0.06, the best of what else there
// was 0.36 off.
constexpr double kAsideBefore = 0.25;
// Of a target that is expected at the picture's edge so much is within it.
constexpr double kAtEdgeShare = 0.1;
// So many of the places where the colours are its own are looked at by turns.
constexpr std::size_t kMostLikely = 8;
// What looks smaller than this cannot be told from other things far away.
constexpr double kLeastSide_px = 8.0;
// And no target is faster than this, or than twice what it was: sizes / s.
constexpr double kFastest = 8.0;

// The point of a straight line from `a` to `b` that is nearest to `p`.
Eigen::Vector2d NearestBetween(const Eigen::Vector2d& a,
                               const Eigen::Vector2d& b,
                               const Eigen::Vector2d& p) {
  const Eigen::Vector2d along = b - a;
  const double length2 = along.squaredNorm();
  const double share =
      length2 > 0.0 ? std::clamp(along.dot(p - a) / length2, 0.0, 1.0) : 0.0;
  return a + share * along;
}

}  // namespace

std::vector<Box2> TargetTrack::NextPlaces(
    const Now& now,
    const std::optional<ImageMotion::Prediction>& predicted,
    const std::optional<Box2>& beside_px) {
  auto budget = static_cast<std::size_t>(now.around.max_search_places);
  const cv::Size size_px = now.frame.size_px();
  // The ground says how large the target is there.
  const CameraView* camera = ground_ ? now.camera : nullptr;
  std::vector<Box2> places;
  const auto add = [&](const Eigen::Vector2d& center) {
    // In 3D a place is one on the ground, and the target as large as it would
    // look there.
    const auto box = camera != nullptr
                         ? ground_->BoxForTrackerAt(*camera, center)
                         : Box2::FromCenter(center, box_px_.size_px());
    if (box && IsInView(*box, size_px, kInViewShare)) {
      places.push_back(*box);
    }
  };
  if (beside_px && budget > 0) {
    places.push_back(*beside_px);
    --budget;
  }
  std::optional<Box2> here;
  if (predicted) {
    here = camera != nullptr
               ? ground_->BoxForTrackerAt(*camera, predicted->center_px)
               : Box2::FromCenter(predicted->center_px, box_px_.size_px());
  }
  // Most of it is expected out of view, a little beyond the picture's edge: it
  // may as well be a little within it, and nothing else looks there. A single
  // look is for the others.
  if (here && budget > 1 && !IsInView(*here, size_px, kInViewShare) &&
      IsInView(*here, size_px, kAtEdgeShare)) {
    const std::size_t count = places.size();
    add(here->center_px()
            .cwiseMax(Eigen::Vector2d::Zero())
            .cwiseMin(Eigen::Vector2d(size_px.width, size_px.height)));
    budget -= places.size() - count;
  }
  // Predicted nowhere, it is taken to look as large as it last did.
  const Eigen::Vector2d step_px = 2.0 * tracker_->Reach(here.value_or(box_px_));
  const bool search_image =
      time_ - last_seen_ >=
      (camera != nullptr ? kSearchGroundAfter : kSearchImageAfter);
  if (hidden_.vanished_behind() && camera != nullptr && budget > 1) {
    // What hides it may have stopped it, or it turned round behind it.
    constexpr std::array<double, 4> kSteps = {0.0, -1.0, 0.0, 1.0};
    if (const auto center = ground_->LastSightedCenter(*camera)) {
      const double step = kSteps[turns_.vanished++ % kSteps.size()];
      add(*center + Eigen::Vector2d(step * step_px.x(), 0.0));
      --budget;
    }
  }
  // The next frame goes on where this one stops.
  std::vector<Eigen::Vector2d> offsets;
  if (here) offsets = SearchOffsets(step_px, predicted->covariance_px2);
  std::size_t near = budget;
  if (search_image) {
    // Of each kind half; a single place by turns.
    near = budget == 1 ? (turns_.near + turns_.image) % 2 : budget - budget / 2;
  }
  // What is out of view there is not looked at. On the ground it leaves its
  // turn to the rest of the image, where the colours are the target's first;
  // without one nothing tells how large the target would look, and more looks
  // find more of what it is not (docs/method.md, "Where its colours are").
  near = std::min(near, offsets.size());
  const bool on_ground = camera != nullptr;
  const std::size_t before = places.size();
  for (std::size_t i = 0;
       i < offsets.size() && (on_ground ? places.size() - before : i) < near;
       ++i) {
    add(predicted->center_px + offsets[turns_.near++ % offsets.size()]);
  }
  if (on_ground) near = places.size() - before;
  if (!search_image || near >= budget) return places;
  const Eigen::Vector2d image_px(size_px.width, size_px.height);
  const auto step_at =
      [&](const Eigen::Vector2d& pixel_px) -> std::optional<Eigen::Vector2d> {
    const auto box = ground_->BoxForTrackerAt(*camera, pixel_px);
    if (!box || !(box->size_px().minCoeff() >= kLeastSide_px)) {
      return std::nullopt;
    }
    return 2.0 * tracker_->Reach(*box);
  };
  const std::vector<Eigen::Vector2d> grid =
      camera != nullptr ? ImagePlaces(step_at, image_px)
                        : ImagePlaces(step_px, image_px);
  std::size_t far = std::min<std::size_t>(grid.size(), budget - near);
  // The rest of the image is not shut out.
  std::size_t by_colour = 0;
  if (on_ground) {
    by_colour = far == 1 ? (turns_.image + turns_.likely) % 2 : far / 2;
  }
  const std::vector<Eigen::Vector2d> likely =
      by_colour > 0 ? LikelyOnGround(now, grid)
                    : std::vector<Eigen::Vector2d>{};
  for (std::size_t i = 0; i < std::min(by_colour, likely.size()); ++i) {
    add(likely[turns_.likely++ % likely.size()]);
    --far;
  }
  for (std::size_t i = 0; i < far; ++i) add(grid[turns_.image++ % grid.size()]);
  return places;
}

std::vector<Eigen::Vector2d> TargetTrack::LikelyOnGround(
    const Now& now, std::span<const Eigen::Vector2d> places_px) const {
  constexpr int kHalvings = image::ColourPicture::kMaxHalvings;
  const cv::Size size_px = now.frame.size_px();
  const cv::Rect all(
      0, 0, size_px.width >> kHalvings, size_px.height >> kHalvings);
  if (all.empty()) return {};
  const cv::Mat probability =
      tracker_->TellByColour(now.frame.Bgr(all, kHalvings));
  if (probability.empty()) return {};
  return LikelyPlaces(
      ColourMap(probability, std::ldexp(1.0, -kHalvings)),
      places_px,
      [&](const Eigen::Vector2d& center_px) {
        return ground_->BoxForTrackerAt(*now.camera, center_px);
      },
      [this](const Box2& box_px) -> Eigen::Vector2d {
        return 2.0 * tracker_->Reach(box_px);
      },
      kMostLikely);
}

double TargetTrack::SurenessOf(
    const target::TargetObservation& observation) const {
  // What is not even believed where it is followed is not recognised.
  if (frames_seen_ > 0 ||
      observation.confidence < options_->confidence_threshold) {
    return observation.confidence;
  }
  return std::max(observation.confidence,
                  observation.recognition.value_or(0.0));
}

double TargetTrack::SureConfidence() const {
  return options_->confidence_threshold +
         kSearchMargin * (1.0 - options_->confidence_threshold);
}

bool TargetTrack::IsReachable(const GroundSighting& sighting) const {
  const double age_s =
      std::chrono::duration<double>(time_ - last_seen_).count();
  const geometry::Box3 box = ground_->box();
  const double fastest_m_s =
      std::max(kFastest * box.size_m.maxCoeff(),
               2.0 * ground_->velocity_world_m_s().norm());
  return ground_->DistanceTo(sighting) <= fastest_m_s * age_s;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::LookFor(const Now& now,
                                                       const Box2& box_px,
                                                       double min_confidence) {
  Look look;
  ASSIGN_OR_RETURN(look.observation, Detect(now.frame, box_px, nullptr, true));
  look.believed =
      SurenessOf(look.observation) >= min_confidence &&
      IsInView(look.observation.box_px, now.frame.size_px(), kInViewShare);
  look.elsewhere = true;
  if (now.camera != nullptr && ground_) {
    look.sighting = ground_->LiftAsLarge(*now.camera, look.observation.box_px);
    look.elsewhere =
        !look.sighting || look.sighting->innovation.surprise > kGate;
    look.believed = look.believed && look.sighting &&
                    (!look.elsewhere || IsReachable(*look.sighting));
  }
  look.believed =
      look.believed && !IsAnother(now, look) && !IsBehindMap(now, look);
  return look;
}

Box2 TargetTrack::AsLargeThere(const Now& now, const Box2& box_px) const {
  return now.camera != nullptr && ground_
             ? ground_->BoxAsLarge(*now.camera, box_px)
             : box_px;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::FollowHypothesis(
    const Now& now) {
  using Verdict = SearchHypothesis::Verdict;
  const std::vector<const target::Appearance*> usual = recalled_;
  if (!hypothesis_->is_sure()) recalled_ = views_.All();
  ASSIGN_OR_RETURN(Look look,
                   LookFor(now,
                           AsLargeThere(now, hypothesis_->box_px()),
                           options_->confidence_threshold));
  const Verdict verdict = look.believed
                              ? hypothesis_->See(SightOf(look), SearchBounds())
                              : Verdict::kRefuted;
  look.believed = verdict == Verdict::kBelieved;
  if (verdict == Verdict::kStoodStill && look.sighting) {
    lookalikes_.Add(look.sighting->place_m, time_);
  }
  if (verdict == Verdict::kRefuted || verdict == Verdict::kStoodStill) {
    hypothesis_.reset();
  }
  if (!hypothesis_ || !hypothesis_->is_sure()) recalled_ = usual;
  return look;
}

bool TargetTrack::MayBeUnsure(const Now& now) const {
  return now.camera != nullptr && ground_ && !now.around.others_are_unseen;
}

absl::StatusOr<TargetTrack::Look> TargetTrack::Search(
    const Now& now,
    const std::optional<ImageMotion::Prediction>& predicted,
    const std::optional<Box2>& beside_px) {
  if (hypothesis_ && !hypothesis_->is_sure() && !MayBeUnsure(now)) {
    hypothesis_.reset();
  }
  if (hypothesis_) {
    ASSIGN_OR_RETURN(const Look look, FollowHypothesis(now));
    // One that is not sure keeps nobody from finding a better one.
    if (look.believed || (hypothesis_ && hypothesis_->is_sure())) return look;
  }
  std::optional<Box2> best_place;
  Look best;
  for (const Box2& place : NextPlaces(now, predicted, beside_px)) {
    ASSIGN_OR_RETURN(const Look look,
                     LookFor(now, place, options_->confidence_threshold));
    if (!look.believed || IsKnownLookalike(look)) continue;
    if (best_place &&
        SurenessOf(look.observation) <= SurenessOf(best.observation)) {
      continue;
    }
    best = look;
    best_place = place;
  }
  if (!best_place) return best;
  // A second look, from where the first one found it: the target looks like
  // itself in the middle of the patch, while at its rim the window dims it.
  if (now.camera != nullptr && ground_) recalled_ = views_.All();
  ASSIGN_OR_RETURN(Look again,
                   LookFor(now,
                           AsLargeThere(now, best.observation.box_px),
                           MayBeUnsure(now) ? options_->confidence_threshold
                                            : SureConfidence()));
  const bool is_sure = SurenessOf(again.observation) >= SureConfidence();
  if (again.believed && (again.elsewhere || !is_sure)) Suppose(again);
  return again;
}

bool TargetTrack::IsKnownLookalike(const Look& look) const {
  if (!look.sighting || !ground_ || frames_seen_ > 0) return false;
  return lookalikes_.IsNear(look.sighting->place_m,
                            kAsideBefore * Side(ground_->box().size_m),
                            time_);
}

absl::StatusOr<bool> TargetTrack::WasThereBefore(const Now& now,
                                                 const Look& look) {
  const CameraView& camera = *now.camera;
  if (!look.sighting || !ground_) return false;
  const Box2& box_px = look.observation.box_px;
  const Eigen::Vector3d p_world =
      ground_->BodyAt(look.sighting->place_m).world_from_object.translation;
  const std::vector<EarlierFrames::Place> places = earlier_frames_.PlacesOf(
      camera,
      box_px,
      (p_world - camera.view.world_from_camera.translation).norm());
  if (places.empty()) return false;
  // In each of the frames that show its place.
  bool was_there = false;
  for (std::size_t i = 0; i < places.size(); ++i) {
    const bool goes_on = i > 0 && places[i].frame == places[i - 1].frame;
    if (i > 0 && !goes_on && !was_there) break;
    if (goes_on && was_there) continue;
    const EarlierFrames::Place& place = places[i];
    ASSIGN_OR_RETURN(const target::TargetObservation then,
                     Detect(*place.frame, place.box_px, nullptr, true));
    // It may stand anywhere between this place and the one before.
    const Eigen::Vector2d before_px =
        (goes_on ? places[i - 1] : place).box_px.center_px();
    const Eigen::Vector2d off_px =
        then.box_px.center_px() - NearestBetween(before_px,
                                                 place.box_px.center_px(),
                                                 then.box_px.center_px());
    was_there =
        then.confidence >= options_->confidence_threshold &&
        off_px.cwiseQuotient(place.box_px.size_px()).norm() < kAsideBefore;
  }
  // The tracker goes on with what it last looked at.
  RETURN_IF_ERROR(Detect(now.frame, box_px, nullptr, true).status());
  return was_there;
}

SearchHypothesis::Sight TargetTrack::SightOf(const Look& look) const {
  // To be recognised and to be found sharply tells apart different things.
  return {
      .box_px = look.observation.box_px,
      .sureness = SurenessOf(look.observation),
      .least_sureness = std::min(look.observation.confidence,
                                 look.observation.recognition.value_or(0.0)),
      .sighting = look.sighting};
}

SearchHypothesis::Bounds TargetTrack::SearchBounds() const {
  return {.threshold = options_->confidence_threshold,
          .sure = SureConfidence()};
}

void TargetTrack::Suppose(Look& look) {
  look.believed = false;
  const auto supposed = SearchHypothesis::Begin(SightOf(look), SearchBounds());
  // Of those that are not sure one at a time.
  if (supposed && (supposed->is_sure() || !hypothesis_)) hypothesis_ = supposed;
}

}  // namespace groundlock::tracking
