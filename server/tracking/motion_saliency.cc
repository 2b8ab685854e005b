// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/motion_saliency.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "map_store/base/order_statistics.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

// Looked at in a picture in which the target's side is no larger: what moves
// need not be seen sharply.
constexpr double kMostSide_px = 32.0;
// So much of a picture is kept about the target: it goes on, and the camera
// turns.
constexpr double kKeptSides = 4.0;
constexpr double kKeptMargin_px = 16.0;  // of that picture
// And so much is compared about the places asked of.
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
// A share of what is known of a box counts as that of the box from here on.
constexpr double kLeastKnown = 0.3;
// A pixel moves from so many standard deviations of noise on, and surely from
// so many. Noise is what most of the picture shows, and a picture that was
// brought here by its neighbours' motion is off by so much of its pixels.
constexpr double kFaint = 2.5;
constexpr double kSure = 5.5;
constexpr double kLeastNoise = 1.5;  // 8-bit levels
constexpr double kOff_px = 0.35;
// From the median of differences to their standard deviation.
constexpr double kSigmaOfMedian = 1.4826;
constexpr int kNoiseStep = 2;  // every so many pixels tell it, either way
constexpr double kLeastValid = 0.5;
// A target is known to move if so much of its box does, and so many times what
// does about it.
constexpr double kMoves = 0.04;
constexpr double kStandsOut = 3.0;
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
// Where all of it would be seen: it spans so much of its box, but for a share
// of its pixels at either end.
constexpr double kSilhouette = 0.9;
constexpr double kTail = 0.05;
constexpr double kFirstReach = 1.5;
constexpr nanoseconds kGone = milliseconds(300);
constexpr double kVelocityRate = 0.3;  // a frame

Box2 Enlarged(const Box2& box_px, double times) {
  return Box2::FromCenter(box_px.center_px(), times * box_px.size_px());
}

double SideOf(const Box2& box_px) {
  return std::sqrt(std::max(1.0, box_px.Area()));
}

ImageSimilarity Inverse(const ImageSimilarity& a) {
  ImageSimilarity inverse;
  inverse.turn = a.turn.inverse();
  inverse.shift_px = -(inverse.turn * a.shift_px);
  return inverse;
}

// First b, then a.
ImageSimilarity Compose(const ImageSimilarity& a, const ImageSimilarity& b) {
  return {.turn = a.turn * b.turn, .shift_px = a * b.shift_px};
}

// Pixels of `picture`, in its own ones from its first corner on; NaN outside.
float Sample(const cv::Mat& picture, double x, double y) {
  const double u = x - image::kPixelCenter;
  const double v = y - image::kPixelCenter;
  if (!(u >= 0.0 && v >= 0.0 && u < picture.cols - 1.0 &&
        v < picture.rows - 1.0)) {
    return std::numeric_limits<float>::quiet_NaN();
  }
  const int column = static_cast<int>(u);
  const int row = static_cast<int>(v);
  const auto a = static_cast<float>(u - column);
  const auto b = static_cast<float>(v - row);
  const std::uint8_t* upper = picture.ptr<std::uint8_t>(row) + column;
  const std::uint8_t* lower = picture.ptr<std::uint8_t>(row + 1) + column;
  return (1.0F - b) * ((1.0F - a) * upper[0] + a * upper[1]) +
         b * ((1.0F - a) * lower[0] + a * lower[1]);
}

// In whole pixels of a picture, of which `size` there are.
cv::Rect Within(const Box2& box_px,
                const Eigen::Vector2d& origin_px,
                double scale,
                const cv::Size& size) {
  const auto at = [](double px, int most) {
    return static_cast<int>(std::lround(std::clamp(px, 0.0, 1.0 * most)));
  };
  const Eigen::Vector2d from = scale * (box_px.min_px - origin_px);
  const Eigen::Vector2d to = scale * (box_px.max_px - origin_px);
  return {cv::Point(at(from.x(), size.width), at(from.y(), size.height)),
          cv::Point(at(to.x(), size.width), at(to.y(), size.height))};
}

}  // namespace

MotionSaliency::Picture MotionSaliency::Take(const image::Frame& frame,
                                             const Box2& box_px) {
  const auto pyramid = frame.Pyramid();
  const double side_px = SideOf(box_px);
  int level = 0;
  while (level + 1 < static_cast<int>(pyramid->levels.size()) &&
         std::ldexp(side_px, -level) > kMostSide_px) {
    ++level;
  }
  Picture picture;
  picture.scale = std::ldexp(1.0, -level);
  picture.time = frame.capture_time;
  const double reach_px = kKeptSides * side_px + kKeptMargin_px / picture.scale;
  const cv::Mat& whole = pyramid->levels[level];
  const cv::Rect part =
      Within(Box2::FromCenter(box_px.center_px(),
                              Eigen::Vector2d::Constant(2.0 * reach_px)),
             Eigen::Vector2d::Zero(),
             picture.scale,
             whole.size());
  picture.origin_px = Eigen::Vector2d(part.x, part.y) / picture.scale;
  if (!part.empty()) {
    cv::GaussianBlur(whole(part),
                     picture.luma,
                     cv::Size(5, 5),
                     1.0,
                     1.0,
                     cv::BORDER_REPLICATE | cv::BORDER_ISOLATED);
  }
  return picture;
}

std::optional<MotionSaliency::Saliency> MotionSaliency::Compare(
    const Picture& at,
    const std::vector<Other>& others,
    const Box2& around_px) {
  if (at.luma.empty() || others.empty()) return std::nullopt;
  const cv::Rect part =
      Within(around_px, at.origin_px, at.scale, at.luma.size()) &
      cv::Rect(1, 1, at.luma.cols - 2, at.luma.rows - 2);
  if (part.width < 4 || part.height < 4) return std::nullopt;
  Saliency saliency;
  saliency.scale = at.scale;
  saliency.origin_px =
      at.origin_px + Eigen::Vector2d(part.x, part.y) / at.scale;
  constexpr float kUnknown = std::numeric_limits<float>::max();
  cv::Mat_<float> least(part.size(), kUnknown);
  cv::Mat_<float> difference(part.size());
  std::vector<double> differences;
  for (const auto& [other, blind_px] : others) {
    if (other->luma.empty()) return std::nullopt;
    const cv::Rect blind =
        blind_px
            ? Within(*blind_px, saliency.origin_px, saliency.scale, part.size())
            : cv::Rect();
    const ImageSimilarity there = Compose(Inverse(other->to_now), at.to_now);
    // From pixels of the one to those of the other.
    const Eigen::Matrix2d turn = other->scale / at.scale * there.turn;
    const Eigen::Vector2d shift =
        other->scale * (there * at.origin_px - other->origin_px);
    differences.clear();
    for (int row = 0; row < part.height; ++row) {
      const std::uint8_t* luma = at.luma.ptr<std::uint8_t>(row + part.y);
      float* to = difference[row];
      const Eigen::Vector2d first =
          turn * Eigen::Vector2d(part.x + image::kPixelCenter,
                                 row + part.y + image::kPixelCenter) +
          shift;
      for (int column = 0; column < part.width; ++column) {
        to[column] = static_cast<float>(luma[column + part.x]) -
                     Sample(other->luma,
                            first.x() + column * turn(0, 0),
                            first.y() + column * turn(1, 0));
      }
      if (row % kNoiseStep != 0) continue;
      for (int column = 0; column < part.width; column += kNoiseStep) {
        if (!std::isnan(to[column])) differences.push_back(to[column]);
      }
    }
    if (std::ssize(differences) * kNoiseStep * kNoiseStep <
        kLeastValid * part.area()) {
      return std::nullopt;
    }
    // The picture as a whole may have become brighter.
    const auto brighter = static_cast<float>(base::Median(differences));
    for (double& value : differences) {
      value = std::abs(static_cast<float>(value) - brighter);
    }
    const double noise =
        std::max(kLeastNoise, kSigmaOfMedian * base::Median(differences));
    for (int row = 0; row < part.height; ++row) {
      const std::uint8_t* above = at.luma.ptr<std::uint8_t>(row + part.y - 1);
      const std::uint8_t* here = at.luma.ptr<std::uint8_t>(row + part.y);
      const std::uint8_t* below = at.luma.ptr<std::uint8_t>(row + part.y + 1);
      const float* from = difference[row];
      float* to = least[row];
      for (int column = 0; column < part.width; ++column) {
        if (blind.contains({column, row})) continue;
        const int x = column + part.x;
        const double gx = 0.5 * (here[x + 1] - here[x - 1]);
        const double gy = 0.5 * (below[x] - above[x]);
        const double variance =
            noise * noise + kOff_px * kOff_px * (gx * gx + gy * gy);
        const float off = from[column] - brighter;
        const auto score = static_cast<float>(off * off / variance);
        // Where one of the two does not reach, nothing moves.
        to[column] = std::isnan(score) ? 0.0F : std::min(to[column], score);
      }
    }
  }
  saliency.values.create(part.size());
  saliency.sums = cv::Mat_<double>::zeros(part.height + 1, part.width + 1);
  saliency.known = saliency.sums.clone();
  for (int row = 0; row < part.height; ++row) {
    double sum = 0.0;
    double known = 0.0;
    for (int column = 0; column < part.width; ++column) {
      if (least(row, column) == kUnknown) {
        least(row, column) = 0.0F;
      } else {
        known += 1.0;
      }
      saliency.known(row + 1, column + 1) =
          saliency.known(row, column + 1) + known;
      const double sigmas = std::sqrt(least(row, column));
      saliency.values(row, column) = static_cast<float>(
          std::clamp((sigmas - kFaint) / (kSure - kFaint), 0.0, 1.0));
      sum += saliency.values(row, column);
      saliency.sums(row + 1, column + 1) = saliency.sums(row, column + 1) + sum;
    }
  }
  return saliency;
}

double MotionSaliency::ShareIn(const Saliency& saliency, const Box2& box_px) {
  const double area = saliency.scale * saliency.scale * box_px.Area();
  const cv::Rect part = Within(
      box_px, saliency.origin_px, saliency.scale, saliency.values.size());
  if (part.empty() || !(area > 0.0)) return 0.0;
  const auto within = [&](const cv::Mat_<double>& sums) {
    return sums(part.br()) - sums(part.y, part.br().x) -
           sums(part.br().y, part.x) + sums(part.tl());
  };
  return within(saliency.sums) /
         (area - std::min(part.area() - within(saliency.known),
                          (1.0 - kLeastKnown) * area));
}

bool MotionSaliency::StandsOut(const Saliency& saliency, const Box2& box_px) {
  const double inside = ShareIn(saliency, box_px);
  // Of three such areas about the box.
  const double about =
      (4.0 * ShareIn(saliency, Enlarged(box_px, 2.0)) - inside) / 3.0;
  return inside >= kStandsOut * about;
}

std::optional<Eigen::Vector2d> MotionSaliency::MiddleOf(
    const Saliency& saliency, const Box2& box_px, double near_px) {
  const cv::Rect part = Within(
      box_px, saliency.origin_px, saliency.scale, saliency.values.size());
  const Eigen::Vector2d center =
      saliency.scale * (box_px.center_px() - saliency.origin_px);
  const double factor = -0.5 / std::pow(saliency.scale * near_px, 2);
  double sum = 0.0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (int row = part.y; row < part.br().y; ++row) {
    for (int column = part.x; column < part.br().x; ++column) {
      if (!(saliency.values(row, column) > 0.0F)) continue;
      const Eigen::Vector2d p(column + image::kPixelCenter,
                              row + image::kPixelCenter);
      const double weight = saliency.values(row, column) *
                            std::exp(factor * (p - center).squaredNorm());
      sum += weight;
      middle += weight * p;
    }
  }
  if (!(sum > 0.0)) return std::nullopt;
  return saliency.origin_px + middle / (sum * saliency.scale);
}

Eigen::Vector2d MotionSaliency::MiddleAround(const Saliency& saliency,
                                             const Box2& expected_px,
                                             const Box2& found_px) {
  const cv::Rect part = Within(Enlarged(found_px, kWindow),
                               saliency.origin_px,
                               saliency.scale,
                               saliency.values.size());
  Eigen::Vector2d center_px = found_px.center_px();
  if (part.empty()) return center_px;
  for (int axis = 0; axis < 2; ++axis) {
    cv::Mat_<float> profile;
    cv::reduce(saliency.values(part), profile, axis, cv::REDUCE_SUM, CV_32F);
    double sum = 0.0;
    for (const float value : profile) sum += value;
    double below = 0.0;
    double from = 0.0;
    double to = 0.0;
    double at = axis == 0 ? part.x : part.y;
    for (const float value : profile) {
      if (below < kTail * sum) from = at;
      if (below < (1.0 - kTail) * sum) to = at + 1.0;
      below += value;
      at += 1.0;
    }
    const double half_px = 0.5 * kSilhouette * expected_px.size_px()[axis];
    const double first_px =
        saliency.origin_px[axis] + to / saliency.scale - half_px;
    const double last_px =
        saliency.origin_px[axis] + from / saliency.scale + half_px;
    if (first_px <= last_px) {
      center_px[axis] =
          std::clamp(expected_px.center_px()[axis], first_px, last_px);
    }
  }
  return center_px;
}

void MotionSaliency::Restart(const image::Frame& frame, const Box2& box_px) {
  *this = MotionSaliency();
  time_ = learnt_ = frame.capture_time;
  first_ = Take(frame, box_px);
  first_->target_px = box_px;
  first_box_px_ = box_px;
  pictures_.push_back(*first_);
}

void MotionSaliency::Add(const image::Frame& frame,
                         const std::optional<ImageSimilarity>& background,
                         bool background_is_known,
                         const Box2& expected_px,
                         const Box2& last_px) {
  time_ = frame.capture_time;
  now_.reset();
  if (background) {
    for (std::deque<Picture>* pictures : {&pictures_, &long_ago_}) {
      for (Picture& picture : *pictures) {
        picture.to_now = Compose(*background, picture.to_now);
      }
    }
    if (first_) first_->to_now = Compose(*background, first_->to_now);
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
  const Picture now =
      Take(frame, Box2::FromCenter(compared_px.center_px(), last_px.size_px()));
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
  if (!others.empty()) now_ = Compare(now, others, compared_px);
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

std::vector<MotionSaliency::Other> MotionSaliency::Choose(
    const Box2& target_px) const {
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

bool MotionSaliency::HasGoneOn(const std::vector<Other>& others,
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
        Compare(*first_,
                {{between, std::nullopt}, {&now, std::nullopt}},
                Enlarged(first_box_px_, 1.0 + 2.0 * kComparedSides));
    const double inside = was ? ShareIn(*was, first_box_px_) : 0.0;
    if (inside >= kMoves && StandsOut(*was, first_box_px_)) {
      Note(inside,
           MiddleOf(*was,
                    Enlarged(first_box_px_, kWindow),
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
       moves
           ? MiddleOf(
                 *now_, Enlarged(box_px, kWindow), kNearSides * SideOf(box_px))
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

void MotionSaliency::FollowTrace(const std::vector<Other>& others,
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
          spot->is_whole ? MiddleAround(*now_, expected_px, spot->box_px)
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
