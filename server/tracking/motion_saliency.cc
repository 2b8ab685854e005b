// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/motion_saliency.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

// So much of a picture is compared about the places asked of.
constexpr double kComparedSides = 1.5;
// The earlier pictures: so old that a target has left its place (a walking
// person goes its width in half a second), and so young that the background's
// motion still holds. Until there are such, younger ones.
constexpr nanoseconds kOlder = milliseconds(800);
constexpr nanoseconds kYoungest = milliseconds(150);
constexpr nanoseconds kApart = milliseconds(90);  // of pictures that are kept
constexpr nanoseconds kFirstTold = milliseconds(300);
// A slow target stands where it was half a second ago, too. How the background
// there looked before it came is told by a picture that is up to so old, in
// which no more than a share of the place was the target's, with a rim, as its
// box is not exact. By then what stands off the ground has moved by a pixel,
// which must be little of the target.
constexpr nanoseconds kLongAgo = milliseconds(10'000);
constexpr nanoseconds kLongApart = milliseconds(400);
constexpr double kSeenThen = 0.3;
constexpr double kRim = 0.1;
constexpr double kLeastSide_px = 20.0;
// A target is known to move if so much of its box does, and that stands out.
constexpr double kMoves = 0.04;
constexpr std::chrono::duration<double> kMemory{0.5};
// What moves like the target: from so much to so many times as much, and so
// much more. More is something else, too.
constexpr double kLikeLeast = 0.5;
constexpr double kLikeMost = 1.3;
constexpr double kLikeMore = 0.1;
constexpr double kWindow = 1.3;  // of the box, for the middle of what moves
constexpr double kNearSides = 0.5;
constexpr int kShifts = 3;
// What moves is followed by itself: found again so near to where it would be if
// it went on, in sides; gone when it was not found for so long.
constexpr double kReach = 0.75;
constexpr double kFirstReach = 1.5;
constexpr nanoseconds kGone = milliseconds(300);
constexpr double kVelocityRate = 0.3;  // a frame

}  // namespace

void MotionSaliency::Restart(const image::Frame& frame, const Box2& box_px) {
  *this = MotionSaliency();
  time_ = learnt_ = frame.capture_time;
  first_ = TakePicture(frame, box_px);
  first_->target_px = box_px;
  first_box_px_ = box_px;
  pictures_.push_back(*first_);
}

void MotionSaliency::Add(const image::Frame& frame,
                         const std::optional<ImageAffinity>& background,
                         bool background_is_known,
                         const Box2& expected_px,
                         const Box2& last_px) {
  time_ = frame.capture_time;
  now_.reset();
  if (background) {
    for (std::deque<Picture>* pictures : {&pictures_, &long_ago_}) {
      for (Picture& picture : *pictures) {
        picture.to_now = *background * picture.to_now;
      }
    }
    if (first_) first_->to_now = *background * first_->to_now;
    if (trace_) {
      Box2& box_px = trace_->spot.box_px;
      box_px =
          Box2::FromCenter(*background * box_px.center_px(), box_px.size_px());
      trace_->spot.velocity_px_s =
          background->turn * trace_->spot.velocity_px_s;
      if (!box_px.IsFinite()) trace_.reset();
    }
  } else {
    pictures_.clear();
    first_.reset();
    trace_.reset();
  }
  if (!background_is_known) long_ago_.clear();
  const double side_px = SideOf(last_px);
  const Eigen::Vector2d about =
      Eigen::Vector2d::Constant(kComparedSides * side_px);
  Box2 compared_px = {expected_px.min_px.cwiseMin(last_px.min_px) - about,
                      expected_px.max_px.cwiseMax(last_px.max_px) + about};
  if (trace_) {
    const Box2& box_px = trace_->spot.box_px;
    compared_px = {compared_px.min_px.cwiseMin(box_px.min_px - about),
                   compared_px.max_px.cwiseMax(box_px.max_px + about)};
  }
  const Picture now = TakePicture(
      frame, Box2::FromCenter(compared_px.center_px(), last_px.size_px()));
  const auto age = [&](const Picture& picture) { return time_ - picture.time; };
  while (!pictures_.empty() && age(pictures_.front()) > kOlder + kApart) {
    if (background_is_known &&
        (long_ago_.empty() ||
         pictures_.front().time - long_ago_.back().time >= kLongApart)) {
      long_ago_.push_back(std::move(pictures_.front()));
    }
    pictures_.pop_front();
  }
  while (!long_ago_.empty() && age(long_ago_.front()) > kLongAgo) {
    long_ago_.pop_front();
  }
  const auto others = Choose(trace_ ? trace_->spot.box_px : expected_px);
  if (!others.empty()) now_ = Differ(now, others, compared_px);
  FollowTrace(others, background_is_known, last_px);
  if (first_ && age(*first_) >= kFirstTold) JudgeFirst(now);
  if (pictures_.empty() || age(pictures_.back()) >= kApart) {
    pictures_.push_back(now);
  }
}

std::optional<Box2> MotionSaliency::TargetIn(const Picture& picture) {
  if (!picture.target_px) return std::nullopt;
  return Box2::FromCenter(picture.to_now * picture.target_px->center_px(),
                          (1.0 + 2.0 * kRim) * picture.target_px->size_px());
}

std::vector<OtherPicture> MotionSaliency::Choose(const Box2& target_px) const {
  const auto age = [&](const Picture& picture) { return time_ - picture.time; };
  if (pictures_.empty() || age(pictures_.front()) < kYoungest) return {};
  const Picture* older = &pictures_.front();
  const Picture* younger = nullptr;
  for (const Picture& picture : pictures_) {
    if (&picture != older && 2 * age(picture) >= age(*older)) {
      younger = &picture;
    }
  }
  if (younger == nullptr) return {};
  // The latest of those that show the target least where it is expected.
  const Picture* before = nullptr;
  double least = std::numeric_limits<double>::max();
  for (auto it = long_ago_.rbegin(); it != long_ago_.rend(); ++it) {
    const auto was_px = TargetIn(*it);
    if (!was_px) continue;
    const double area = Intersection(*was_px, target_px).Area();
    if (area < least) {
      least = area;
      before = &*it;
    }
  }
  if (before == nullptr || least > kSeenThen * target_px.Area() ||
      SideOf(target_px) < kLeastSide_px) {
    return {{older, std::nullopt}, {younger, std::nullopt}};
  }
  return {{older, TargetIn(*older)},
          {younger, TargetIn(*younger)},
          {before, TargetIn(*before)}};
}

bool MotionSaliency::HasGoneOn(const std::vector<OtherPicture>& others,
                               const Box2& box_px) {
  if (others.size() != 2) return true;
  const auto older_px = TargetIn(*others[0].picture);
  const auto younger_px = TargetIn(*others[1].picture);
  if (!older_px || !younger_px) return true;
  const Eigen::Vector2d was_px = younger_px->center_px();
  return (was_px - older_px->center_px()).dot(box_px.center_px() - was_px) >=
         0.0;
}

void MotionSaliency::JudgeFirst(const Picture& now) {
  // As old as the younger of those that tell what moves now.
  const Picture* between = nullptr;
  const nanoseconds age = now.time - first_->time;
  for (const Picture& picture : pictures_) {
    if (between == nullptr && picture.time < now.time &&
        2 * (picture.time - first_->time) >= age) {
      between = &picture;
    }
  }
  if (between != nullptr) {
    const auto was =
        Differ(*first_,
               std::array{OtherPicture{between, std::nullopt},
                          OtherPicture{&now, std::nullopt}},
               EnlargedTimes(first_box_px_, 1.0 + 2.0 * kComparedSides));
    const double inside = was ? ShareIn(*was, first_box_px_) : 0.0;
    if (inside >= kMoves && StandsOut(*was, first_box_px_)) {
      Note(inside,
           MiddleOf(*was,
                    EnlargedTimes(first_box_px_, kWindow),
                    kNearSides * SideOf(first_box_px_)),
           first_box_px_,
           1.0);
      const Eigen::Vector2d was_px = first_->to_now * first_box_px_.center_px();
      const auto spot =
          trace_ ? std::nullopt
                 : FindNear(Box2::FromCenter(was_px, first_box_px_.size_px()),
                            kFirstReach * SideOf(first_box_px_));
      if (spot) trace_ = Trace{.spot = *spot, .found = time_};
    }
  }
  if (age > kOlder) first_.reset();
}

void MotionSaliency::Note(double share,
                          const std::optional<Eigen::Vector2d>& middle_px,
                          const Box2& box_px,
                          double rate) {
  share_ += rate * (share - share_);
  if (!middle_px) return;
  const Eigen::Vector2d offset =
      (*middle_px - box_px.center_px()) / SideOf(box_px);
  offset_sides_ += rate * (offset - offset_sides_);
}

void MotionSaliency::Mark(const Box2& box_px) {
  if (!pictures_.empty() && pictures_.back().time == time_) {
    pictures_.back().target_px = box_px;
  }
}

void MotionSaliency::Learn(const Box2& box_px) {
  if (!now_ || first_) return;
  const double share = ShareIn(*now_, box_px);
  const bool stands_out = StandsOut(*now_, box_px);
  const double rate =
      1.0 - std::exp(-std::chrono::duration<double>(time_ - learnt_) / kMemory);
  learnt_ = time_;
  // A target that stops moves no more; what has only been mistaken for it
  // leaves a trace of it that goes on.
  const bool moves = stands_out && share >= kMoves;
  if (!moves && spot()) return;
  Note(stands_out ? share : 0.0,
       moves ? MiddleOf(*now_,
                        EnlargedTimes(box_px, kWindow),
                        kNearSides * SideOf(box_px))
             : std::nullopt,
       box_px,
       rate);
  if (!moves || share < kLikeLeast * share_) return;
  const auto spot = FindNear(box_px, kReach * SideOf(box_px));
  if (!spot) {
    trace_.reset();
    return;
  }
  const bool is_same =
      trace_ && (trace_->spot.box_px.center_px() - box_px.center_px()).norm() <
                    0.5 * SideOf(box_px);
  if (!is_same) {
    trace_ = Trace{.spot = *spot, .found = time_};
  }
}

std::optional<double> MotionSaliency::ShareAt(const Box2& box_px) const {
  if (!now_) return std::nullopt;
  return ShareIn(*now_, box_px);
}

std::optional<MotionSaliency::Spot> MotionSaliency::spot() const {
  if (!trace_ || trace_->found != time_) return std::nullopt;
  return trace_->spot;
}

void MotionSaliency::FollowTrace(const std::vector<OtherPicture>& others,
                                 bool background_is_known,
                                 const Box2& last_px) {
  if (!trace_) return;
  const double age_s =
      std::chrono::duration<double>(time_ - trace_->found).count();
  const double side_px = SideOf(last_px);
  const Eigen::Vector2d from_px = trace_->spot.box_px.center_px();
  const Eigen::Vector2d velocity_px_s = trace_->spot.velocity_px_s;
  const Box2 expected_px =
      Box2::FromCenter(from_px + age_s * velocity_px_s, last_px.size_px());
  if (auto spot = FindNear(expected_px, kReach * side_px)) {
    spot->velocity_px_s = velocity_px_s;
    spot->is_whole = others.size() > 2;
    spot->has_gone_on = !background_is_known || HasGoneOn(others, spot->box_px);
    // Of what moves less than the target a part is hidden: its middle is not
    // the target's, which goes on as it went.
    double seen = 1.0;
    if (background_is_known) {
      seen = std::min(1.0, spot->share / share_);
      const Eigen::Vector2d center_px =
          spot->is_whole
              ? MiddleAround(
                    *now_, expected_px, EnlargedTimes(spot->box_px, kWindow))
              : Eigen::Vector2d(expected_px.center_px() +
                                seen * (spot->box_px.center_px() -
                                        expected_px.center_px()));
      spot->box_px = Box2::FromCenter(center_px, expected_px.size_px());
    }
    if (age_s > 0.0) {
      spot->velocity_px_s +=
          kVelocityRate * seen *
          ((spot->box_px.center_px() - from_px) / age_s - velocity_px_s);
    }
    trace_->spot = *spot;
    trace_->found = time_;
  } else if (time_ - trace_->found > kGone) {
    trace_.reset();
  }
}

std::optional<MotionSaliency::Spot> MotionSaliency::FindNear(
    const Box2& expected_px, double reach_px) const {
  if (!now_ || share_ < kMoves) return std::nullopt;
  const double side_px = SideOf(expected_px);
  const Eigen::Vector2d offset_px = side_px * offset_sides_;
  const double step_px = 0.25 * side_px;
  const int steps = static_cast<int>(std::ceil(reach_px / step_px));
  double best = 0.0;
  Eigen::Vector2d middle_px = Eigen::Vector2d::Zero();
  for (int i = -steps; i <= steps; ++i) {
    for (int j = -steps; j <= steps; ++j) {
      const Eigen::Vector2d off_px = step_px * Eigen::Vector2d(j, i);
      if (off_px.norm() > reach_px) continue;
      const Eigen::Vector2d center_px =
          expected_px.center_px() + offset_px + off_px;
      const double score =
          ShareIn(*now_, Box2::FromCenter(center_px, expected_px.size_px())) *
          std::exp(-0.5 * (2.0 * off_px / reach_px).squaredNorm());
      if (score > best) {
        best = score;
        middle_px = center_px;
      }
    }
  }
  if (!(best > 0.0)) return std::nullopt;
  // Of several things that move, that which is nearest to there.
  for (int i = 0; i < kShifts; ++i) {
    const auto middle =
        MiddleOf(*now_,
                 Box2::FromCenter(middle_px, kWindow * expected_px.size_px()),
                 kNearSides * side_px);
    if (!middle) return std::nullopt;
    middle_px = *middle;
  }
  Spot spot;
  spot.box_px = Box2::FromCenter(middle_px - offset_px, expected_px.size_px());
  spot.share =
      ShareIn(*now_, Box2::FromCenter(middle_px, expected_px.size_px()));
  if (spot.share < std::max(kMoves, kLikeLeast * share_) ||
      spot.share > kLikeMost * share_ + kLikeMore ||
      (spot.box_px.center_px() - expected_px.center_px()).norm() >
          1.5 * reach_px) {
    return std::nullopt;
  }
  return spot;
}

}  // namespace groundlock::tracking
