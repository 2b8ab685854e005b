// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/background_motion.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "server/ground/ground_model.h"
#include "server/image/patch_flow.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// So far around the target corners are looked for: in its sides, and at least.
constexpr double kReachSides = 3.0;
constexpr double kLeastReach_px = 80.0;
// In a picture no larger than this: a target's background needs no more.
constexpr int kMostSide_px = 200;
constexpr int kMostCorners = 60;
constexpr int kCornerBlock_px = 5;
constexpr double kCornerQuality = 0.01;
constexpr double kCornersApart_px = 8.0;
// The target itself, and its rim, tell nothing of the background.
constexpr double kTargetMargin = 0.15;
// Levels above the one looked at: motion of so many patches is found again.
constexpr int kLevelsAbove = 4;
constexpr double kMaxDifference = 25.0;  // mean of 8-bit levels
constexpr double kAgreement_px = 1.5;    // of the level looked at
constexpr int kMinAgreeing = 8;
// The picture in which the shift of the whole is looked for, and how clear that
// must be (cv::phaseCorrelate's share of the energy at the peak).
constexpr int kCoarseSide_px = 160;
constexpr double kLeastResponse = 0.1;

cv::Rect Clip(const Box2& box_px, const cv::Size& size) {
  const auto at = [](double px, int most) {
    return static_cast<int>(std::lround(std::clamp(px, 0.0, 1.0 * most)));
  };
  return {cv::Point(at(box_px.min_px.x(), size.width),
                    at(box_px.min_px.y(), size.height)),
          cv::Point(at(box_px.max_px.x(), size.width),
                    at(box_px.max_px.y(), size.height))};
}

// How far the whole picture has moved, to a few of its pixels: so far that
// Lucas-Kanade, which starts where a point was, would not find it again.
// Rounded, so that it does not depend on how a processor reckons.
cv::Point2d CoarseShift_px(const image::LumaPyramid& from,
                           const image::LumaPyramid& to) {
  std::size_t level = 0;
  while (level + 1 < from.levels.size() &&
         from.levels[level].cols > kCoarseSide_px) {
    ++level;
  }
  cv::Mat before;
  cv::Mat after;
  from.levels[level].convertTo(before, CV_32F);
  to.levels[level].convertTo(after, CV_32F);
  cv::Mat window;
  cv::createHanningWindow(window, before.size(), CV_32F);
  double response = 0.0;
  const cv::Point2d shift =
      cv::phaseCorrelate(before, after, window, &response);
  if (!(response >= kLeastResponse)) return {};
  return {std::ldexp(std::round(shift.x), static_cast<int>(level)),
          std::ldexp(std::round(shift.y), static_cast<int>(level))};
}

}  // namespace

ImageAffinity ImageAffinity::Inverse() const {
  ImageAffinity inverse;
  inverse.turn = turn.inverse();
  inverse.shift_px = -(inverse.turn * shift_px);
  return inverse;
}

std::optional<ImageAffinity> BackgroundMotion::Follow(const image::Frame& frame,
                                                      const Box2& target_px) {
  const auto from = std::exchange(last_pyramid_, frame.Pyramid());
  if (from == nullptr || from->size_px != last_pyramid_->size_px ||
      !target_px.IsFinite()) {
    return std::nullopt;
  }
  const double reach_px = std::max(
      kLeastReach_px, kReachSides * std::sqrt(std::max(1.0, target_px.Area())));
  int level = 0;
  while (level + 1 < static_cast<int>(from->levels.size()) &&
         std::ldexp(2.0 * reach_px, -level) > kMostSide_px) {
    ++level;
  }
  const double scale = std::ldexp(1.0, -level);
  const cv::Mat& picture = from->levels[level];
  const cv::Rect around =
      Clip(Box2::FromCenter(scale * target_px.center_px(),
                            Eigen::Vector2d::Constant(2.0 * scale * reach_px)),
           picture.size());
  if (around.width <= 2 * kCornerBlock_px ||
      around.height <= 2 * kCornerBlock_px) {
    return std::nullopt;
  }
  const cv::Rect target =
      Clip(Box2::FromCenter(
               scale * target_px.center_px(),
               (1.0 + 2.0 * kTargetMargin) * scale * target_px.size_px()),
           picture.size()) &
      around;
  cv::Mat mask(around.size(), CV_8UC1, cv::Scalar(255));
  if (!target.empty()) mask(target - around.tl()).setTo(0);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(picture(around),
                          corners,
                          kMostCorners,
                          kCornerQuality,
                          kCornersApart_px,
                          mask,
                          kCornerBlock_px);
  std::vector<cv::Point2f> before_px;
  std::vector<cv::Point2f> after_px;
  const image::PatchFlowOptions options{.coarsest_level = level + kLevelsAbove,
                                        .finest_level = level};
  const cv::Point2d shift_px = CoarseShift_px(*from, *last_pyramid_);
  for (const cv::Point2f& corner : corners) {
    const cv::Point2d pixel_px(
        (corner.x + around.x + image::kPixelCenter) / scale,
        (corner.y + around.y + image::kPixelCenter) / scale);
    const auto flow = image::FollowPatch(
        *from, *last_pyramid_, pixel_px, pixel_px + shift_px, options);
    if (!flow || flow->difference > kMaxDifference) continue;
    before_px.emplace_back(pixel_px);
    after_px.emplace_back(flow->point_px);
  }
  if (static_cast<int>(before_px.size()) < kMinAgreeing) return std::nullopt;
  std::vector<std::uint8_t> agrees;
  const cv::Mat found = cv::estimateAffinePartial2D(
      before_px, after_px, agrees, cv::RANSAC, kAgreement_px / scale);
  if (found.empty() ||
      std::count(agrees.begin(), agrees.end(), 1) <
          std::max<std::ptrdiff_t>(kMinAgreeing, std::ssize(before_px) / 2)) {
    return std::nullopt;
  }
  ImageAffinity similarity;
  for (int row = 0; row < 2; ++row) {
    similarity.turn(row, 0) = found.at<double>(row, 0);
    similarity.turn(row, 1) = found.at<double>(row, 1);
    similarity.shift_px[row] = found.at<double>(row, 2);
  }
  return similarity;
}

void BackgroundMotion::Keep(const image::Frame& frame) {
  last_pyramid_ = frame.Pyramid();
}

std::optional<ImageAffinity> MotionOfPlane(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera_before,
    const geometry::Rigid3& world_from_camera,
    const geometry::Plane& plane_world,
    const Box2& target_px) {
  const ground::GroundView before{
      &camera, world_from_camera_before, plane_world};
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  const double reach_px = std::sqrt(std::max(1.0, target_px.Area()));
  Eigen::Matrix<double, 2, 4> from, to;
  for (int i = 0; i < 4; ++i) {
    from.col(i) =
        target_px.center_px() +
        reach_px * Eigen::Vector2d(i % 2 == 0 ? -1.0 : 1.0, i < 2 ? -1.0 : 1.0);
    const auto ray = ground::RayWorld(before, from.col(i));
    const auto p_world =
        ray ? IntersectRay(
                  plane_world, world_from_camera_before.translation, *ray)
            : std::nullopt;
    const auto pixel =
        p_world ? camera.ImageFromCamera(camera_from_world * *p_world)
                : std::nullopt;
    if (!pixel) return std::nullopt;
    to.col(i) = *pixel;
  }
  // Least squares: the corners of a square lie evenly about its middle.
  const Eigen::Vector2d from_mean = from.rowwise().mean();
  const Eigen::Vector2d to_mean = to.rowwise().mean();
  from.colwise() -= from_mean;
  ImageAffinity affinity;
  affinity.turn = to * from.transpose() / (4.0 * reach_px * reach_px);
  affinity.shift_px = to_mean - affinity.turn * from_mean;
  return affinity;
}

}  // namespace groundlock::tracking
