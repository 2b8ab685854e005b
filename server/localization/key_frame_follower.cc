// SPDX-License-Identifier: Apache-2.0
#include "server/localization/key_frame_follower.h"

#include <algorithm>
#include <opencv2/video/tracking.hpp>

#include "server/image/frame.h"

namespace groundlock::localization {
namespace {

const cv::Size kWindow(image::LumaPyramid::kWindowPx,
                       image::LumaPyramid::kWindowPx);
constexpr int kMaxLevel = image::LumaPyramid::kMaxLevel;
constexpr int kMaxIterations = 12;
constexpr double kEpsilonPx = 0.02;
// Mean absolute difference of the patches, 8-bit levels: above it the patch
// shows something else (an occluder), though Lucas-Kanade converged.
constexpr float kMaxPatchDifference = 24.0F;
constexpr int kBorderPx = 4;
constexpr int kGridColumns = 16;
constexpr int kGridRows = 9;

cv::Point2f ToOpenCv(const Eigen::Vector2d& pixel_px) {
  return {static_cast<float>(pixel_px.x() - image::kPixelCenter),
          static_cast<float>(pixel_px.y() - image::kPixelCenter)};
}

}  // namespace

std::vector<FollowedLandmark> SpreadOverImage(
    const map::Map& map,
    std::span<const FollowedLandmark> followed,
    cv::Size size_px,
    int max_landmarks) {
  std::vector<std::vector<const FollowedLandmark*>> cells(kGridColumns *
                                                          kGridRows);
  for (const FollowedLandmark& landmark : followed) {
    const Eigen::Vector2d& pixel_px = landmark.match.pixel_px;
    const int column = std::clamp(
        static_cast<int>(pixel_px.x() * kGridColumns / size_px.width),
        0,
        kGridColumns - 1);
    const int row =
        std::clamp(static_cast<int>(pixel_px.y() * kGridRows / size_px.height),
                   0,
                   kGridRows - 1);
    cells[row * kGridColumns + column].push_back(&landmark);
  }
  const auto landmarks = map.landmarks();
  std::size_t deepest = 0;
  for (auto& cell : cells) {
    std::sort(cell.begin(), cell.end(), [&](const auto* a, const auto* b) {
      if (a->is_anchored != b->is_anchored) return a->is_anchored;
      const auto views_a = landmarks[a->match.landmark].num_observations;
      const auto views_b = landmarks[b->match.landmark].num_observations;
      return views_a != views_b ? views_a > views_b
                                : a->match.landmark < b->match.landmark;
    });
    deepest = std::max(deepest, cell.size());
  }
  std::vector<FollowedLandmark> chosen;
  const auto limit = static_cast<std::size_t>(max_landmarks);
  for (std::size_t depth = 0; depth < deepest; ++depth) {
    for (const auto& cell : cells) {
      if (depth < cell.size() && chosen.size() < limit) {
        chosen.push_back(*cell[depth]);
      }
    }
  }
  return chosen;
}

std::vector<FollowedLandmark> FollowLandmarks(
    const map::Map& map,
    const KeyFrame& key_frame,
    const image::LumaPyramid& current,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& predicted_world_from_camera) {
  const geometry::Rigid3 camera_from_world =
      predicted_world_from_camera.Inverse();
  std::vector<const FollowedLandmark*> sources;
  std::vector<cv::Point2f> key_points;
  std::vector<cv::Point2f> points;
  for (const FollowedLandmark& landmark : key_frame.landmarks) {
    const LandmarkMatch& match = landmark.match;
    const auto guess = camera.ImageFromCamera(
        camera_from_world * map.landmarks()[match.landmark].Position());
    if (!guess || !camera.IsInsideImage(*guess, kBorderPx)) continue;
    sources.push_back(&landmark);
    key_points.push_back(ToOpenCv(match.pixel_px));
    points.push_back(ToOpenCv(*guess));
  }
  std::vector<FollowedLandmark> found;
  if (sources.empty()) return found;

  std::vector<unsigned char> status;
  std::vector<float> difference;
  cv::calcOpticalFlowPyrLK(
      key_frame.pyramid->levels,
      current.levels,
      key_points,
      points,
      status,
      difference,
      kWindow,
      kMaxLevel,
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS,
                       kMaxIterations,
                       kEpsilonPx),
      cv::OPTFLOW_USE_INITIAL_FLOW);
  found.reserve(sources.size());
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (status[i] == 0 || difference[i] > kMaxPatchDifference) continue;
    const Eigen::Vector2d pixel_px(points[i].x + image::kPixelCenter,
                                   points[i].y + image::kPixelCenter);
    if (!camera.IsInsideImage(pixel_px, kBorderPx)) continue;
    found.push_back(
        {{sources[i]->match.landmark, pixel_px}, sources[i]->is_anchored});
  }
  return found;
}

}  // namespace groundlock::localization
