// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/upright_edges.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "map_store/base/parallel_for.h"
#include "map_store/decoding/image_reader.h"

namespace groundlock::build::internal {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// Edges are found in images of this size, and are as long as that share of the
// width: a segment of 30 pixels is known to half a degree.
constexpr int kMaxSize_px = 1'600;
constexpr double kLeastLength = 1.0 / 40.0;
constexpr std::size_t kMaxImages = 100;
constexpr std::size_t kMaxPlanes = 20'000;

// Directions that are tried: on a grid about the guess, as fine as the error of
// an edge (1 sigma).
constexpr double kCone_rad = 30.0 * kDegree;
constexpr double kEdgeSigma_rad = 0.5 * kDegree;
constexpr int kRounds = 30;
// Directions farther than this from the best one are others.
constexpr double kOther_rad = 3.0 * kDegree;
// The best one has so many edges, stands so many sigmas out of how many others
// have, and so much more than the next best.
constexpr double kLeastEdges = 60.0;
constexpr double kLeastSigmas = 8.0;
constexpr double kLeastContrast = 1.4;

// How many of the planes hold a direction, each by its error.
double EdgesAlong(std::span<const Eigen::Vector3d> normals,
                  const Eigen::Vector3d& direction) {
  constexpr double kReach = 3.0 * kEdgeSigma_rad;
  double count = 0.0;
  for (const Eigen::Vector3d& normal : normals) {
    const double sine = normal.dot(direction);
    if (std::abs(sine) > kReach) continue;
    count += std::exp(-0.5 * sine * sine / (kEdgeSigma_rad * kEdgeSigma_rad));
  }
  return count;
}

// The direction that the planes about it hold, by weighted least squares.
Eigen::Vector3d Refined(std::span<const Eigen::Vector3d> normals,
                        Eigen::Vector3d direction) {
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& normal : normals) {
      const double z = normal.dot(direction) / kEdgeSigma_rad;
      if (std::abs(z) > 3.0) continue;
      sum += std::exp(-0.5 * z * z) * normal * normal.transpose();
    }
    const Eigen::Vector3d next =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(sum).eigenvectors().col(
            0);
    direction = next.dot(direction) < 0.0 ? Eigen::Vector3d(-next) : next;
  }
  return direction;
}

std::vector<Eigen::Vector3d> DirectionsAbout(const Eigen::Vector3d& middle) {
  const Eigen::Vector3d x = middle.unitOrthogonal();
  const Eigen::Vector3d y = middle.cross(x);
  const int steps = static_cast<int>(kCone_rad / kEdgeSigma_rad);
  std::vector<Eigen::Vector3d> directions;
  for (int i = -steps; i <= steps; ++i) {
    for (int j = -steps; j <= steps; ++j) {
      if (i * i + j * j > steps * steps) continue;
      directions.push_back((middle + std::tan(kEdgeSigma_rad * i) * x +
                            std::tan(kEdgeSigma_rad * j) * y)
                               .normalized());
    }
  }
  return directions;
}

}  // namespace

std::vector<Eigen::Vector3d> FindEdgePlanes(
    const cv::Mat& luma, const geometry::CameraModel& camera) {
  cv::Mat image = luma;
  const int size_px = std::max(luma.cols, luma.rows);
  if (size_px == 0) return {};
  if (size_px > kMaxSize_px) {
    const double shrink = static_cast<double>(kMaxSize_px) / size_px;
    cv::resize(luma, image, cv::Size(), shrink, shrink, cv::INTER_AREA);
  }
  std::vector<cv::Vec4f> segments;
  try {
    cv::createLineSegmentDetector()->detect(image, segments);
  } catch (const cv::Exception&) {
    return {};  // as of an image without edges
  }
  // From OpenCV's pixels, whose first one's centre is 0.
  const Eigen::Array2d scale(
      static_cast<double>(camera.width_px()) / image.cols,
      static_cast<double>(camera.height_px()) / image.rows);
  std::vector<Eigen::Vector3d> normals;
  for (const cv::Vec4f& segment : segments) {
    const Eigen::Array2d from(segment[0] + 0.5, segment[1] + 0.5);
    const Eigen::Array2d to(segment[2] + 0.5, segment[3] + 0.5);
    if ((to - from).matrix().norm() < kLeastLength * image.cols) continue;
    const auto ray_from = camera.RayFromImage((scale * from).matrix());
    const auto ray_to = camera.RayFromImage((scale * to).matrix());
    if (!ray_from || !ray_to) continue;
    normals.push_back(ray_from->cross(*ray_to).normalized());
  }
  return normals;
}

std::optional<map::UprightEdges> UpByEdgePlanes(
    std::span<const Eigen::Vector3d> normals_world,
    const Eigen::Vector3d& up_guess) {
  // Those that can hold one of the directions.
  std::vector<Eigen::Vector3d> normals;
  const double reach = std::sin(kCone_rad + 3.0 * kEdgeSigma_rad);
  for (const Eigen::Vector3d& normal : normals_world) {
    if (std::abs(normal.dot(up_guess)) < reach) normals.push_back(normal);
  }
  if (static_cast<double>(normals.size()) < kLeastEdges) return std::nullopt;
  if (normals.size() > kMaxPlanes) {
    const std::size_t step = normals.size() / kMaxPlanes + 1;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < normals.size(); i += step) {
      normals[kept++] = normals[i];
    }
    normals.resize(kept);
  }
  const std::vector<Eigen::Vector3d> directions = DirectionsAbout(up_guess);
  std::vector<double> counts(directions.size());
  constexpr std::size_t kRange = 64;
  base::ParallelFor(
      directions.size(), kRange, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
          counts[i] = EdgesAlong(normals, directions[i]);
        }
      });
  const auto best = static_cast<std::size_t>(
      std::max_element(counts.begin(), counts.end()) - counts.begin());
  std::vector<double> others;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    if (directions[i].dot(directions[best]) < std::cos(kOther_rad)) {
      others.push_back(counts[i]);
    }
  }
  const double next = *std::max_element(others.begin(), others.end());
  const double median = base::Median(others);
  for (double& count : others) count = std::abs(count - median);
  constexpr double kSigmaOfMad = 1.4826;
  const double sigma = kSigmaOfMad * base::Median(std::move(others));
  const double excess = counts[best] - median;
  if (counts[best] < kLeastEdges || excess < kLeastSigmas * sigma ||
      excess < kLeastContrast * (next - median)) {
    return std::nullopt;
  }
  return map::UprightEdges{Refined(normals, directions[best]),
                           static_cast<int>(std::lround(counts[best]))};
}

std::optional<map::UprightEdges> FindUprightEdges(
    const map::MapData& data, const std::filesystem::path& folder) {
  const std::size_t step = data.views.size() / kMaxImages + 1;
  std::vector<std::vector<Eigen::Vector3d>> of_view(data.views.size());
  decoding::ImageReader reader;
  for (std::size_t v = 0; v < data.views.size(); v += step) {
    const map::MapViewData& view = data.views[v];
    const auto luma = reader.ReadLuma(folder / view.name);
    if (!luma.ok()) continue;
    of_view[v] = FindEdgePlanes(*luma, data.cameras[view.camera]);
  }
  std::vector<Eigen::Vector3d> normals_world;
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    const Eigen::Quaterniond world_from_camera =
        data.views[v].camera_from_world.rotation.conjugate();
    for (const Eigen::Vector3d& normal : of_view[v]) {
      normals_world.push_back(world_from_camera * normal);
    }
  }
  return UpByEdgePlanes(normals_world, map::UpByCameras(data));
}

}  // namespace groundlock::build::internal
