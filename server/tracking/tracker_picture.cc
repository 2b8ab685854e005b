// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/tracker_picture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// What linear interpolation reads beside a place.
constexpr double kBeside_px = 2.0;
// How much coarser than a frame, short of half as fine, a turned picture is
// drawn if the tracker can do with it: turning costs by the pixel. Above the
// other, the frame is halved first, so that nothing is skipped.
constexpr std::array<double, 3> kCoarser = {1.75, 1.5, 1.25};
constexpr double kHalvedFirst = 1.4;

// Rounded outwards, within the image: boxes may be anywhere.
cv::Rect PixelsOf(const Box2& box_px, const cv::Size& size_px) {
  const auto pixel = [](double px, int size) {
    return static_cast<int>(std::clamp(px, 0.0, 1.0 * size));
  };
  const cv::Point first(pixel(std::floor(box_px.min_px.x()), size_px.width),
                        pixel(std::floor(box_px.min_px.y()), size_px.height));
  const cv::Point last(pixel(std::ceil(box_px.max_px.x()), size_px.width),
                       pixel(std::ceil(box_px.max_px.y()), size_px.height));
  return {first, last};
}

// A tracker that would halve its picture of a larger box sees this one as well
// in a coarser picture.
double CoarserBy(const target::TargetTracker& tracker, const Box2& box_px) {
  for (const double coarser : kCoarser) {
    if (tracker.Halvings(Box2::FromCenter(
            box_px.center_px(), 2.0 / coarser * box_px.size_px())) > 0) {
      return coarser;
    }
  }
  return 1.0;
}

cv::Size Halved(const cv::Size& size_px, int halvings) {
  return {size_px.width >> halvings, size_px.height >> halvings};
}

}  // namespace

void TrackerPicture::Show(const image::Frame& frame,
                          const target::TargetTracker& tracker,
                          const Box2& box_px,
                          const PatchTurn& turn) {
  turn_ = {};
  const Box2 there_px = Box2::FromCenter(
      box_px.center_px(), box_px.size_px().cwiseProduct(turn.size_ratio));
  const int least = std::min(frame.size_px().width, frame.size_px().height);
  halvings_ = std::min({tracker.Halvings(there_px),
                        image::ColourPicture::kMaxHalvings,
                        static_cast<int>(std::log2(least))});
  if (turn.angle_rad == 0.0) return;
  const double scale = std::ldexp(1.0, -halvings_);
  Box2 small_px{scale * there_px.min_px, scale * there_px.max_px};
  double coarser = CoarserBy(tracker, small_px);
  const Eigen::Vector2d window_px =
      tracker
          .DetectBox(Box2::FromCenter(small_px.center_px(),
                                      small_px.size_px() / coarser))
          .size_px()
          .array()
          .ceil();
  const cv::Size size_px = Halved(frame.size_px(), halvings_);
  // Trackers that read everything, and boxes that are no target's.
  if (!window_px.allFinite() ||
      window_px.maxCoeff() > 2.0 * std::max(size_px.width, size_px.height)) {
    return;
  }
  if (coarser > kHalvedFirst &&
      halvings_ < image::ColourPicture::kMaxHalvings &&
      (least >> (halvings_ + 1)) > 0) {
    ++halvings_;
    coarser *= 0.5;
    small_px = {0.5 * small_px.min_px, 0.5 * small_px.max_px};
  }
  turn_ = turn;
  const Eigen::Rotation2Dd turned(turn.angle_rad);
  frame_from_picture_ = coarser * turned.toRotationMatrix();
  picture_from_frame_ = turned.inverse().toRotationMatrix() / coarser;
  coarser_ = coarser;
  middle_px_ = small_px.center_px();
  picture_middle_px_ = 0.5 * window_px;
  picture_.create(static_cast<int>(window_px.y()),
                  static_cast<int>(window_px.x()),
                  CV_8UC3);
  Draw(frame);
}

void TrackerPicture::Draw(const image::Frame& frame) {
  drawn_ = frame.capture_time;
  const Eigen::Vector2d half_px =
      frame_from_picture_.cwiseAbs() * picture_middle_px_ +
      Eigen::Vector2d::Constant(kBeside_px);
  const cv::Size size_px = Halved(frame.size_px(), halvings_);
  cv::Rect read =
      PixelsOf({middle_px_ - half_px, middle_px_ + half_px}, size_px);
  // At least one pixel: outside, the edge is repeated.
  read.x = std::clamp(read.x, 0, size_px.width - 1);
  read.y = std::clamp(read.y, 0, size_px.height - 1);
  read.width = std::max(read.width, 1);
  read.height = std::max(read.height, 1);
  const cv::Mat pixels = frame.Bgr(read, halvings_)(read);
  const Eigen::Vector2d origin_px(read.x, read.y);
  const Eigen::Vector2d half_pixel =
      Eigen::Vector2d::Constant(image::kPixelCenter);
  // Of the first pixel's centre of the picture.
  const Eigen::Vector2d first_px =
      middle_px_ + frame_from_picture_ * (half_pixel - picture_middle_px_) -
      origin_px - half_pixel;
  const cv::Matx23d from_picture(frame_from_picture_(0, 0),
                                 frame_from_picture_(0, 1),
                                 first_px.x(),
                                 frame_from_picture_(1, 0),
                                 frame_from_picture_(1, 1),
                                 first_px.y());
  cv::warpAffine(pixels,
                 picture_,
                 from_picture,
                 picture_.size(),
                 cv::INTER_LINEAR | cv::WARP_INVERSE_MAP,
                 cv::BORDER_REPLICATE);
}

Eigen::Vector2d TrackerPicture::ToTracker(const Eigen::Vector2d& p_px) const {
  Eigen::Vector2d small_px = std::ldexp(1.0, -halvings_) * p_px;
  if (!IsTurned()) return small_px;
  return picture_middle_px_ + picture_from_frame_ * (small_px - middle_px_);
}

Box2 TrackerPicture::ToTracker(const Box2& box_px) const {
  const double scale = std::ldexp(1.0, -halvings_);
  if (!IsTurned()) return {scale * box_px.min_px, scale * box_px.max_px};
  return Box2::FromCenter(
      ToTracker(box_px.center_px()),
      scale / coarser_ * box_px.size_px().cwiseProduct(turn_.size_ratio));
}

Box2 TrackerPicture::FromTracker(const Box2& box_px) const {
  const double scale = std::ldexp(1.0, halvings_);
  if (!IsTurned()) return {scale * box_px.min_px, scale * box_px.max_px};
  const Eigen::Vector2d center_px =
      middle_px_ +
      frame_from_picture_ * (box_px.center_px() - picture_middle_px_);
  return Box2::FromCenter(
      scale * center_px,
      scale * coarser_ * box_px.size_px().cwiseQuotient(turn_.size_ratio));
}

Eigen::Matrix2d TrackerPicture::ToTracker(
    const Eigen::Matrix2d& covariance_px2) const {
  Eigen::Matrix2d small_px2 = std::ldexp(1.0, -2 * halvings_) * covariance_px2;
  if (!IsTurned()) return small_px2;
  return picture_from_frame_ * small_px2 * picture_from_frame_.transpose();
}

bool TrackerPicture::Holds(const image::Frame& frame,
                           const Box2& box_px) const {
  if (!IsTurned()) return true;
  const Box2 there_px = ToTracker(box_px);
  return frame.capture_time == drawn_ && there_px.min_px.minCoeff() >= 0.0 &&
         there_px.max_px.x() <= picture_.cols &&
         there_px.max_px.y() <= picture_.rows;
}

const cv::Mat& TrackerPicture::Within(const image::Frame& frame,
                                      const Box2& read_px) const {
  if (IsTurned()) return picture_;
  return frame.Bgr(PixelsOf(read_px, Halved(frame.size_px(), halvings_)),
                   halvings_);
}

}  // namespace groundlock::tracking
