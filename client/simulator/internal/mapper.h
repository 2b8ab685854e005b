// SPDX-License-Identifier: Apache-2.0
// A map from rendered views: SIFT, matching, triangulation. The poses are the
// true ones; features, matches and points carry the errors of real ones.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_MAPPER_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_MAPPER_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <opencv2/core.hpp>
#include <string>
#include <utility>
#include <vector>

#include "client/simulator/internal/lens.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

struct MapView {
  std::string name;
  geometry::Rigid3 camera_from_world;
  // Per feature; pixels with the first one's centre at (0.5, 0.5).
  std::vector<Eigen::Vector2d> p_px;
  std::vector<std::array<float, 2>> scale_angle;  // px, rad
  std::vector<std::array<std::uint8_t, 3>> rgb;
  cv::Mat descriptors;         // CV_8U, n x 128, RootSIFT times 512
  std::vector<int> landmarks;  // or -1
};

struct MapLandmark {
  Eigen::Vector3d p_world;
  std::array<std::uint8_t, 3> rgb{};
  double error_px = 0.0;                   // mean over the track
  std::vector<std::pair<int, int>> track;  // view, feature
};

struct YardMap {
  Lens lens;
  std::vector<MapView> views;
  std::vector<MapLandmark> landmarks;
};

// SIFT of a CV_8UC3 image into `view`; its pose and name are left alone.
void ExtractFeatures(const cv::Mat& bgr, MapView& view);

// Matches views that see the same part of the scene, guided by the epipolar
// lines, joins the matches to tracks, triangulates those of at least three
// views and keeps observations within 1.5 px.
//   progress  called with the finished fraction from the calling thread;
//             false stops: returns false, landmarks unspecified.
bool Triangulate(YardMap& map,
                 int threads,
                 const std::function<bool(double)>& progress);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_MAPPER_H_
