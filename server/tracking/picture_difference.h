// SPDX-License-Identifier: Apache-2.0
// Which pixels about a target differ from earlier pictures.
#ifndef GROUNDLOCK_SERVER_TRACKING_PICTURE_DIFFERENCE_H_
#define GROUNDLOCK_SERVER_TRACKING_PICTURE_DIFFERENCE_H_

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>

#include "map_store/geometry/box.h"
#include "server/image/frame.h"
#include "server/tracking/background_motion.h"

namespace groundlock::tracking {

// Here boxes and places are in pixels of the whole image, the first one's
// centre at (0.5, 0.5). All of it is thread-safe.

// The square root of its area, at least a pixel.
inline double SideOf(const geometry::Box2& box_px) {
  return std::sqrt(std::max(1.0, box_px.Area()));
}
// About its middle.
inline geometry::Box2 EnlargedTimes(const geometry::Box2& box_px,
                                    double times) {
  return geometry::Box2::FromCenter(box_px.center_px(),
                                    times * box_px.size_px());
}

// A box in whole pixels of a picture of `size`, that has `scale` of them per
// pixel of the image and its first corner at `origin_px`; clipped to it.
cv::Rect PixelsWithin(const geometry::Box2& box_px,
                      const Eigen::Vector2d& origin_px,
                      double scale,
                      const cv::Size& size);

// A part of a frame, blurred, and smaller if the target is large.
struct Picture {
  cv::Mat luma;
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();  // its first corner
  double scale = 1.0;  // its pixels per pixel of the image
  std::chrono::nanoseconds time{0};
  ImageAffinity to_now;  // where its background is in the newest frame
  std::optional<geometry::Box2> target_px;  // in its frame, if seen
};
// What lies four sides about the box, and a margin.
Picture TakePicture(const image::Frame& frame, const geometry::Box2& box_px);

// How much each pixel of a part of a picture moves, from 0 to 1.
struct Difference {
  cv::Mat_<float> values;
  // Of all above and left of a corner of pixels, and how many of these are
  // known.
  cv::Mat_<double> sums;
  cv::Mat_<double> known;
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  double scale = 1.0;
};
// One that a picture is compared with.
struct OtherPicture {
  const Picture* picture = nullptr;
  // The target stood here in it, in the picture that is compared: what that
  // hid is not known.
  std::optional<geometry::Box2> blind_px;
};
// What differs from each of the others, about `around_px`. A difference counts
// by how it stands out of the noise, which is what most pixels show, and of
// what an error of the background's motion makes at an edge. nullopt: one of
// them shows less than half of it, or it is too small.
std::optional<Difference> Differ(const Picture& at,
                                 std::span<const OtherPicture> others,
                                 const geometry::Box2& around_px);

// Which share of the box differs, of what is known of it; less where less than
// three tenths are known.
double ShareIn(const Difference& difference, const geometry::Box2& box_px);
// Does three times as much differ in the box as about it?
bool StandsOut(const Difference& difference, const geometry::Box2& box_px);
// Of what differs in the box, the middle, that near the box's middle most
// (a normal distribution of `near_px`).
std::optional<Eigen::Vector2d> MiddleOf(const Difference& difference,
                                        const geometry::Box2& box_px,
                                        double near_px);
// Of a target of which all that is seen differs, the middle nearest to where
// its box is expected, such that the box has in it what differs in `within_px`:
// what hides a part of it takes nothing away from that. Where more differs than
// the box holds, it is the middle of `within_px`.
Eigen::Vector2d MiddleAround(const Difference& difference,
                             const geometry::Box2& expected_px,
                             const geometry::Box2& within_px);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_PICTURE_DIFFERENCE_H_
