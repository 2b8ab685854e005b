// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/picture_difference.h"

#include <cstdint>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "map_store/base/order_statistics.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Looked at in a picture in which the target's side is no larger: what moves
// need not be seen sharply.
constexpr double kMostSide_px = 32.0;
// So much of a picture is kept about the target: it goes on, and the camera
// turns.
constexpr double kKeptSides = 4.0;
constexpr double kKeptMargin_px = 16.0;  // of that picture
// Of a box of which less is known no share is made up from that.
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
// So many times what moves about a box stands out.
constexpr double kStandsOut = 3.0;
// Where all of it would be seen: it spans so much of its box, but for a share
// of its pixels at either end.
constexpr double kSilhouette = 0.9;
constexpr double kTail = 0.05;

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

}  // namespace

cv::Rect PixelsWithin(const Box2& box_px,
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

Picture TakePicture(const image::Frame& frame, const Box2& box_px) {
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
      PixelsWithin(Box2::FromCenter(box_px.center_px(),
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

std::optional<Difference> Differ(const Picture& at,
                                 std::span<const OtherPicture> others,
                                 const Box2& around_px) {
  if (at.luma.empty() || others.empty()) return std::nullopt;
  const cv::Rect part =
      PixelsWithin(around_px, at.origin_px, at.scale, at.luma.size()) &
      cv::Rect(1, 1, at.luma.cols - 2, at.luma.rows - 2);
  if (part.width < 4 || part.height < 4) return std::nullopt;
  Difference result;
  result.scale = at.scale;
  result.origin_px = at.origin_px + Eigen::Vector2d(part.x, part.y) / at.scale;
  constexpr float kUnknown = std::numeric_limits<float>::max();
  cv::Mat_<float> least(part.size(), kUnknown);
  cv::Mat_<float> difference(part.size());
  std::vector<double> differences;
  for (const auto& [other, blind_px] : others) {
    if (other->luma.empty()) return std::nullopt;
    const cv::Rect blind =
        blind_px ? PixelsWithin(
                       *blind_px, result.origin_px, result.scale, part.size())
                 : cv::Rect();
    const ImageAffinity there = other->to_now.Inverse() * at.to_now;
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
  result.values.create(part.size());
  result.sums = cv::Mat_<double>::zeros(part.height + 1, part.width + 1);
  result.known = result.sums.clone();
  for (int row = 0; row < part.height; ++row) {
    double sum = 0.0;
    double known = 0.0;
    for (int column = 0; column < part.width; ++column) {
      if (least(row, column) == kUnknown) {
        least(row, column) = 0.0F;
      } else {
        known += 1.0;
      }
      result.known(row + 1, column + 1) = result.known(row, column + 1) + known;
      const double sigmas = std::sqrt(least(row, column));
      result.values(row, column) = static_cast<float>(
          std::clamp((sigmas - kFaint) / (kSure - kFaint), 0.0, 1.0));
      sum += result.values(row, column);
      result.sums(row + 1, column + 1) = result.sums(row, column + 1) + sum;
    }
  }
  return result;
}

double ShareIn(const Difference& difference, const Box2& box_px) {
  const double area = difference.scale * difference.scale * box_px.Area();
  const cv::Rect part = PixelsWithin(
      box_px, difference.origin_px, difference.scale, difference.values.size());
  if (part.empty() || !(area > 0.0)) return 0.0;
  const auto within = [&](const cv::Mat_<double>& sums) {
    return sums(part.br()) - sums(part.y, part.br().x) -
           sums(part.br().y, part.x) + sums(part.tl());
  };
  return within(difference.sums) /
         (area - std::min(part.area() - within(difference.known),
                          (1.0 - kLeastKnown) * area));
}

bool StandsOut(const Difference& difference, const Box2& box_px) {
  const double inside = ShareIn(difference, box_px);
  // Of three such areas about the box.
  const double about =
      (4.0 * ShareIn(difference, EnlargedTimes(box_px, 2.0)) - inside) / 3.0;
  return inside >= kStandsOut * about;
}

std::optional<Eigen::Vector2d> MiddleOf(const Difference& difference,
                                        const Box2& box_px,
                                        double near_px) {
  const cv::Rect part = PixelsWithin(
      box_px, difference.origin_px, difference.scale, difference.values.size());
  const Eigen::Vector2d center =
      difference.scale * (box_px.center_px() - difference.origin_px);
  const double factor = -0.5 / std::pow(difference.scale * near_px, 2);
  double sum = 0.0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (int row = part.y; row < part.br().y; ++row) {
    for (int column = part.x; column < part.br().x; ++column) {
      if (!(difference.values(row, column) > 0.0F)) continue;
      const Eigen::Vector2d p(column + image::kPixelCenter,
                              row + image::kPixelCenter);
      const double weight = difference.values(row, column) *
                            std::exp(factor * (p - center).squaredNorm());
      sum += weight;
      middle += weight * p;
    }
  }
  if (!(sum > 0.0)) return std::nullopt;
  return difference.origin_px + middle / (sum * difference.scale);
}

Eigen::Vector2d MiddleAround(const Difference& difference,
                             const Box2& expected_px,
                             const Box2& within_px) {
  const cv::Rect part = PixelsWithin(within_px,
                                     difference.origin_px,
                                     difference.scale,
                                     difference.values.size());
  Eigen::Vector2d center_px = within_px.center_px();
  if (part.empty()) return center_px;
  for (int axis = 0; axis < 2; ++axis) {
    cv::Mat_<float> profile;
    cv::reduce(difference.values(part), profile, axis, cv::REDUCE_SUM, CV_32F);
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
        difference.origin_px[axis] + to / difference.scale - half_px;
    const double last_px =
        difference.origin_px[axis] + from / difference.scale + half_px;
    if (first_px <= last_px) {
      center_px[axis] =
          std::clamp(expected_px.center_px()[axis], first_px, last_px);
    }
  }
  return center_px;
}

}  // namespace groundlock::tracking
