// SPDX-License-Identifier: Apache-2.0
#include "server/localization/rotation_flow.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <random>
#include <vector>

#include "server/image/frame.h"

namespace groundlock::localization {
namespace {

using Ray = Eigen::Vector3d;

// A turn shows in few pixels: corners are followed where the image's longer
// side is at most so long.
constexpr int kMaxSide_px = 480;
constexpr int kMaxCorners = 150;
constexpr double kCornerQuality = 0.01;
constexpr double kCornerDistance_px = 8.0;
constexpr double kThereAndBack_px = 0.5;
constexpr double kInlier_px = 2.0;
constexpr int kMinTurnInliers = 16;
constexpr double kMinTurnInlierShare = 0.5;
constexpr int kRounds = 60;

struct RayPair {
  Ray before;
  Ray now;
};

// Levels of a pyramid from one of halved images on.
struct HalvedPyramid {
  std::vector<cv::Mat> levels;
  int halvings = 0;

  // In the full image, of a point of the first level.
  Eigen::Vector2d ToPixel(const cv::Point2f& p) const {
    const double scale = 1 << halvings;
    return {scale * (p.x + image::kPixelCenter),
            scale * (p.y + image::kPixelCenter)};
  }
  cv::Point2f FromPixel(const Eigen::Vector2d& pixel_px) const {
    const double scale = 1.0 / (1 << halvings);
    return {static_cast<float>(scale * pixel_px.x() - image::kPixelCenter),
            static_cast<float>(scale * pixel_px.y() - image::kPixelCenter)};
  }
};

HalvedPyramid Halve(const image::LumaPyramid& pyramid) {
  const std::size_t step = pyramid.has_derivatives ? 2 : 1;
  HalvedPyramid half;
  std::size_t first = 0;
  while (first + step < pyramid.levels.size() &&
         std::max(pyramid.levels[first].cols, pyramid.levels[first].rows) >
             kMaxSide_px) {
    first += step;
    ++half.halvings;
  }
  // Derivatives are made for the few points where they are not there.
  for (std::size_t i = first; i < pyramid.levels.size(); i += step) {
    half.levels.push_back(pyramid.levels[i]);
  }
  return half;
}

// before_from_now, least squares.
Eigen::Quaterniond FitRotation(std::span<const RayPair> pairs) {
  Eigen::Matrix3d M = Eigen::Matrix3d::Zero();
  for (const RayPair& pair : pairs) {
    M.noalias() += pair.before * pair.now.transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(
      M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d D = Eigen::Matrix3d::Identity();
  D(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  return Eigen::Quaterniond(svd.matrixU() * D * svd.matrixV().transpose());
}

std::vector<RayPair> FollowCorners(
    const image::LumaPyramid& full_before,
    const image::LumaPyramid& full_now,
    const geometry::CameraModel& camera,
    std::span<const geometry::Box2> masks_px,
    const Eigen::Quaterniond& expected_before_from_now) {
  const HalvedPyramid before = Halve(full_before);
  const HalvedPyramid now = Halve(full_now);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(before.levels.front(),
                          corners,
                          kMaxCorners,
                          kCornerQuality,
                          kCornerDistance_px);
  std::erase_if(corners, [&](const cv::Point2f& corner) {
    return std::any_of(masks_px.begin(), masks_px.end(), [&](const auto& mask) {
      return mask.Contains(before.ToPixel(corner));
    });
  });
  const Eigen::Quaterniond now_from_before =
      expected_before_from_now.conjugate();
  std::vector<Ray> rays;
  std::vector<cv::Point2f> there;
  std::size_t kept = 0;
  for (const cv::Point2f& corner : corners) {
    const auto ray = camera.RayFromImage(before.ToPixel(corner));
    if (!ray) continue;
    const auto guess = camera.ImageFromCamera(now_from_before * *ray);
    if (!guess || !camera.IsInsideImage(*guess)) continue;
    corners[kept++] = corner;
    rays.push_back(*ray);
    there.push_back(now.FromPixel(*guess));
  }
  corners.resize(kept);
  std::vector<RayPair> pairs;
  if (corners.empty()) return pairs;

  const cv::Size window(image::LumaPyramid::kWindowPx,
                        image::LumaPyramid::kWindowPx);
  const int max_level = static_cast<int>(before.levels.size()) - 1;
  const cv::TermCriteria until(
      cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 12, 0.03);
  std::vector<cv::Point2f> back = corners;
  std::vector<unsigned char> found_there;
  std::vector<unsigned char> found_back;
  std::vector<float> difference;
  cv::calcOpticalFlowPyrLK(before.levels,
                           now.levels,
                           corners,
                           there,
                           found_there,
                           difference,
                           window,
                           max_level,
                           until,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  cv::calcOpticalFlowPyrLK(now.levels,
                           before.levels,
                           there,
                           back,
                           found_back,
                           difference,
                           window,
                           max_level,
                           until,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (found_there[i] == 0 || found_back[i] == 0) continue;
    const cv::Point2f loop = back[i] - corners[i];
    if (std::hypot(loop.x, loop.y) > kThereAndBack_px) continue;
    const Eigen::Vector2d pixel_px = now.ToPixel(there[i]);
    const auto ray = camera.RayFromImage(pixel_px);
    if (!ray || !camera.IsInsideImage(pixel_px)) continue;
    pairs.push_back({rays[i], *ray});
  }
  return pairs;
}

std::vector<RayPair> InliersOf(std::span<const RayPair> pairs,
                               const Eigen::Quaterniond& before_from_now,
                               double max_error_rad) {
  std::vector<RayPair> inliers;
  for (const RayPair& pair : pairs) {
    if ((before_from_now * pair.now - pair.before).norm() < max_error_rad) {
      inliers.push_back(pair);
    }
  }
  return inliers;
}

}  // namespace

std::optional<FlowRotation> EstimateRotation(
    const image::LumaPyramid& before,
    const image::LumaPyramid& now,
    const geometry::CameraModel& camera,
    std::span<const geometry::Box2> masks_px,
    const Eigen::Quaterniond& expected_before_from_now,
    std::uint64_t seed) {
  if (before.size_px != now.size_px) return std::nullopt;
  const std::vector<RayPair> pairs =
      FollowCorners(before, now, camera, masks_px, expected_before_from_now);
  if (pairs.size() < static_cast<std::size_t>(kMinTurnInliers)) {
    return std::nullopt;
  }
  const double max_error_rad = kInlier_px / camera.mean_focal_px();
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<std::size_t> draw(0, pairs.size() - 1);
  std::vector<RayPair> best;
  for (int round = 0; round < kRounds; ++round) {
    const RayPair sample[] = {pairs[draw(random)], pairs[draw(random)]};
    // Two directions that nearly coincide leave the turn about them open.
    if (sample[0].before.cross(sample[1].before).norm() < 0.05) continue;
    auto inliers = InliersOf(pairs, FitRotation(sample), max_error_rad);
    if (inliers.size() > best.size()) best = std::move(inliers);
  }
  if (best.size() < 3) return std::nullopt;
  FlowRotation result;
  result.before_from_now = FitRotation(best);
  best = InliersOf(pairs, result.before_from_now, max_error_rad);
  if (best.size() < static_cast<std::size_t>(kMinTurnInliers) ||
      static_cast<double>(best.size()) <
          kMinTurnInlierShare * static_cast<double>(pairs.size())) {
    return std::nullopt;
  }
  result.before_from_now = FitRotation(best);
  result.num_inliers = static_cast<int>(best.size());
  double squared = 0.0;
  for (const RayPair& pair : best) {
    squared += (result.before_from_now * pair.now - pair.before).squaredNorm();
  }
  result.rms_error_rad = std::sqrt(squared / static_cast<double>(best.size()));
  return result;
}

}  // namespace groundlock::localization
