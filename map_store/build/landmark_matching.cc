// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/landmark_matching.h"

#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>

namespace groundlock::build::internal {
namespace {

// Leaf lists that are looked into: more find more, ever more slowly.
constexpr int kLists = 8;
constexpr double kRatioTest = 0.8;
constexpr double kPnpGate_px = 4.0;
constexpr int kPnpIterations = 2'000;
constexpr double kPnpConfidence = 0.9999;

}  // namespace

std::vector<std::vector<ObservationId>> ObservationsByLandmark(
    const map::MapData& data) {
  std::vector<std::vector<ObservationId>> observations(data.landmarks.size());
  for (std::uint32_t v = 0; v < data.views.size(); ++v) {
    const auto& landmarks = data.views[v].landmarks;
    for (std::uint32_t f = 0; f < landmarks.size(); ++f) {
      observations[landmarks[f]].push_back({v, f});
    }
  }
  return observations;
}

std::vector<LandmarkMatch> MatchToLandmarks(
    std::span<const map::Descriptor> queries,
    const map::LandmarkIndex& index,
    double ratio) {
  std::map<std::uint32_t, LandmarkMatch> by_landmark;
  const double squared_ratio = ratio * ratio;
  for (std::uint32_t q = 0; q < queries.size(); ++q) {
    const map::IndexMatch found = map::FindLandmark(index, queries[q], kLists);
    if (found.landmark == map::IndexMatch::kNone ||
        found.squared_distance >
            squared_ratio * found.second_squared_distance) {
      continue;
    }
    const LandmarkMatch match{q, found.landmark, found.squared_distance};
    const auto [it, is_new] = by_landmark.emplace(found.landmark, match);
    if (!is_new && match.squared_distance < it->second.squared_distance) {
      it->second = match;
    }
  }
  std::vector<LandmarkMatch> matches;
  for (const auto& [landmark, match] : by_landmark) matches.push_back(match);
  return matches;
}

// OpenCV's RANSAC starts from a seed of its own, so this is deterministic.
std::optional<FoundPose> FindPose(const ImageFeatures& features,
                                  const geometry::CameraModel& camera,
                                  const map::MapData& data,
                                  const map::LandmarkIndex& index,
                                  int min_inliers) {
  const std::vector<LandmarkMatch> matches =
      MatchToLandmarks(features.descriptors, index, kRatioTest);
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> rays;
  std::vector<LandmarkMatch> used;
  for (const LandmarkMatch& match : matches) {
    const auto xy = camera.NormalizedFromImage(
        features.keypoints_px[match.query].cast<double>());
    if (!xy) continue;
    const Eigen::Vector3d& p = data.landmarks[match.landmark].p_world;
    points.emplace_back(p.x(), p.y(), p.z());
    rays.emplace_back(xy->x(), xy->y());
    used.push_back(match);
  }
  if (static_cast<int>(points.size()) < min_inliers) return std::nullopt;
  cv::Mat rotation;
  cv::Mat translation;
  cv::Mat inliers;
  try {
    if (!cv::solvePnPRansac(
            points,
            rays,
            cv::Mat::eye(3, 3, CV_64F),
            cv::noArray(),
            rotation,
            translation,
            false,
            kPnpIterations,
            static_cast<float>(kPnpGate_px / camera.mean_focal_px()),
            kPnpConfidence,
            inliers,
            cv::SOLVEPNP_AP3P)) {
      return std::nullopt;
    }
  } catch (const cv::Exception&) {
    return std::nullopt;  // a degenerate set
  }
  if (inliers.rows < min_inliers) return std::nullopt;
  FoundPose placed;
  const Eigen::Vector3d v(
      rotation.at<double>(0), rotation.at<double>(1), rotation.at<double>(2));
  placed.camera_from_world.rotation = geometry::QuaternionFromRotationVector(v);
  placed.camera_from_world.translation = {translation.at<double>(0),
                                          translation.at<double>(1),
                                          translation.at<double>(2)};
  if (!placed.camera_from_world.IsFinite()) return std::nullopt;
  for (int i = 0; i < inliers.rows; ++i) {
    placed.inliers.push_back(
        used[static_cast<std::size_t>(inliers.at<int>(i))]);
  }
  return placed;
}

}  // namespace groundlock::build::internal
