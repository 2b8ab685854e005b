// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/rotation_flow.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "map_store/geometry/ransac.h"
#include "server/image/frame.h"
#include "server/image/patch_flow.h"

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

// The first level that is small enough, or the last there is.
int CornerLevel(const image::LumaPyramid& pyramid) {
  int level = 0;
  while (level + 1 < static_cast<int>(pyramid.levels.size()) &&
         std::max(pyramid.levels[level].cols, pyramid.levels[level].rows) >
             kMaxSide_px) {
    ++level;
  }
  return level;
}

// In the image, the corners of that level of it.
std::vector<cv::Point2d> FindCorners_px(const image::LumaPyramid& pyramid,
                                        int level) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(pyramid.levels[level],
                          corners,
                          kMaxCorners,
                          kCornerQuality,
                          kCornerDistance_px);
  const double scale = 1 << level;
  std::vector<cv::Point2d> corners_px;
  corners_px.reserve(corners.size());
  for (const cv::Point2f& corner : corners) {
    corners_px.emplace_back(scale * (corner.x + image::kPixelCenter),
                            scale * (corner.y + image::kPixelCenter));
  }
  return corners_px;
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
    const image::LumaPyramid& before,
    const image::LumaPyramid& now,
    const geometry::CameraModel& camera,
    std::span<const geometry::Box2> masks_px,
    const Eigen::Quaterniond& expected_before_from_now) {
  const Eigen::Quaterniond now_from_before =
      expected_before_from_now.conjugate();
  image::PatchFlowOptions options;
  options.coarsest_level = image::LumaPyramid::kMaxLevel;
  options.finest_level = CornerLevel(before);
  options.epsilon_px = 0.03;
  const double there_and_back_px =
      kThereAndBack_px * (1 << options.finest_level);
  std::vector<RayPair> pairs;
  for (const cv::Point2d& corner :
       FindCorners_px(before, options.finest_level)) {
    const Eigen::Vector2d corner_px(corner.x, corner.y);
    if (std::any_of(masks_px.begin(), masks_px.end(), [&](const auto& mask) {
          return mask.Contains(corner_px);
        })) {
      continue;
    }
    const auto ray = camera.RayFromImage(corner_px);
    if (!ray) continue;
    const auto guess = camera.ImageFromCamera(now_from_before * *ray);
    if (!guess || !camera.IsInsideImage(*guess)) continue;
    const auto there = image::FollowPatch(
        before, now, corner, {guess->x(), guess->y()}, options);
    if (!there) continue;
    const auto back =
        image::FollowPatch(now, before, there->point_px, corner, options);
    if (!back) continue;
    const cv::Point2d loop = back->point_px - corner;
    if (std::hypot(loop.x, loop.y) > there_and_back_px) continue;
    const Eigen::Vector2d there_px(there->point_px.x, there->point_px.y);
    const auto ray_there = camera.RayFromImage(there_px);
    if (!ray_there || !camera.IsInsideImage(there_px)) continue;
    pairs.push_back({*ray, *ray_there});
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

// Two directions propose a turn; those agree that follow it.
struct TurnProblem {
  using Model = Eigen::Quaterniond;  // before_from_now
  using Support = std::vector<RayPair>;

  std::span<const RayPair> pairs;
  double max_error_rad;

  template <typename Consider>
  void Sample(std::mt19937_64& engine, Consider consider) const {
    std::uniform_int_distribution<std::size_t> draw(0, pairs.size() - 1);
    const RayPair sample[] = {pairs[draw(engine)], pairs[draw(engine)]};
    // Two directions that nearly coincide leave the turn about them open.
    if (sample[0].before.cross(sample[1].before).norm() < 0.05) return;
    consider(FitRotation(sample));
  }
  std::optional<Support> SupportOf(const Model& turn,
                                   const Support* best) const {
    Support inliers = InliersOf(pairs, turn, max_error_rad);
    if (best != nullptr && inliers.size() <= best->size()) return std::nullopt;
    return inliers;
  }
};

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
  std::mt19937_64 engine(seed);
  TurnProblem problem{pairs, max_error_rad};
  const auto found = geometry::Ransac(problem, kRounds, engine);
  if (!found.best || found.best->support.size() < 3) return std::nullopt;
  std::vector<RayPair> best = found.best->support;
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
