// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/triangulation.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

namespace groundlock::build::internal {
namespace {

constexpr std::size_t kMaxProposers = 12;
constexpr int kRefinements = 5;
constexpr double kParallel = 1e-9;

struct Ray {
  Eigen::Vector3d origin_world;
  Eigen::Vector3d direction_world;  // unit
};

// Nearest to both rays; nullopt if they are parallel or it lies behind one.
std::optional<Eigen::Vector3d> Midpoint(const Ray& a, const Ray& b) {
  const double cosine = a.direction_world.dot(b.direction_world);
  const double denominator = 1.0 - cosine * cosine;
  if (denominator < kParallel) return std::nullopt;
  const Eigen::Vector3d baseline = b.origin_world - a.origin_world;
  const double along_a = baseline.dot(a.direction_world);
  const double along_b = baseline.dot(b.direction_world);
  const double s = (along_a - cosine * along_b) / denominator;
  const double t = (cosine * along_a - along_b) / denominator;
  if (s <= 0.0 || t <= 0.0) return std::nullopt;
  return 0.5 * (a.origin_world + s * a.direction_world + b.origin_world +
                t * b.direction_world);
}

double ErrorPx(const Sight& sight, const Eigen::Vector3d& p_world) {
  const auto pixel =
      sight.camera->ImageFromCamera(sight.camera_from_world * p_world);
  return pixel ? (*pixel - sight.pixel_px).norm()
               : std::numeric_limits<double>::infinity();
}

std::vector<bool> Inliers(std::span<const Sight> sights,
                          const Eigen::Vector3d& p_world,
                          double max_error_px) {
  std::vector<bool> inliers(sights.size());
  for (std::size_t i = 0; i < sights.size(); ++i) {
    inliers[i] = ErrorPx(sights[i], p_world) <= max_error_px;
  }
  return inliers;
}

Eigen::Vector3d Refine(std::span<const Sight> sights,
                       const std::vector<bool>& inliers,
                       Eigen::Vector3d p_world) {
  for (int round = 0; round < kRefinements; ++round) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < sights.size(); ++i) {
      if (!inliers[i]) continue;
      const Sight& sight = sights[i];
      Eigen::Matrix<double, 2, 3> jacobian;
      const auto pixel = sight.camera->ImageFromCamera(
          sight.camera_from_world * p_world, &jacobian);
      if (!pixel) continue;
      const Eigen::Matrix<double, 2, 3> J =
          jacobian * sight.camera_from_world.rotation.toRotationMatrix();
      normal += J.transpose() * J;
      gradient += J.transpose() * (sight.pixel_px - *pixel);
    }
    const Eigen::Vector3d step = normal.ldlt().solve(gradient);
    if (!step.allFinite()) break;
    p_world += step;
  }
  return p_world;
}

}  // namespace

std::optional<Triangulated> Triangulate(std::span<const Sight> sights,
                                        const TriangulationOptions& options) {
  std::vector<Ray> rays;
  for (const Sight& sight : sights) {
    const auto ray = sight.camera->RayFromImage(sight.pixel_px);
    const geometry::Rigid3 world_from_camera =
        sight.camera_from_world.Inverse();
    // A pixel without a ray proposes nothing and fits nothing.
    rays.push_back({world_from_camera.translation,
                    ray ? Eigen::Vector3d(world_from_camera.rotation * *ray)
                        : Eigen::Vector3d::Zero()});
  }
  const std::size_t count = std::min(rays.size(), kMaxProposers);
  Triangulated best;
  std::ptrdiff_t best_count = 0;
  for (std::size_t a = 0; a < count; ++a) {
    for (std::size_t b = a + 1; b < count; ++b) {
      const std::size_t i = a * rays.size() / count;
      const std::size_t j = b * rays.size() / count;
      const auto point = Midpoint(rays[i], rays[j]);
      if (!point) continue;
      std::vector<bool> inliers =
          Inliers(sights, *point, 2.0 * options.max_error_px);
      const auto agreeing = std::count(inliers.begin(), inliers.end(), true);
      if (agreeing <= best_count) continue;
      best_count = agreeing;
      best.p_world = *point;
      best.is_inlier = std::move(inliers);
    }
  }
  if (best_count < 2) return std::nullopt;
  // Refined by those who proposed it, then by those who really agree.
  for (int round = 0; round < 2; ++round) {
    best.p_world = Refine(sights, best.is_inlier, best.p_world);
    best.is_inlier = Inliers(sights, best.p_world, options.max_error_px);
  }
  double cosine = 1.0;
  int inliers = 0;
  for (std::size_t i = 0; i < sights.size(); ++i) {
    if (!best.is_inlier[i]) continue;
    ++inliers;
    best.mean_error_px += ErrorPx(sights[i], best.p_world);
    for (std::size_t j = 0; j < i; ++j) {
      if (!best.is_inlier[j]) continue;
      const Eigen::Vector3d to_i = best.p_world - rays[i].origin_world;
      const Eigen::Vector3d to_j = best.p_world - rays[j].origin_world;
      cosine = std::min(cosine, to_i.normalized().dot(to_j.normalized()));
    }
  }
  if (inliers < options.min_sights || inliers < 2) return std::nullopt;
  best.mean_error_px /= inliers;
  best.angle_rad = std::acos(std::clamp(cosine, -1.0, 1.0));
  if (best.angle_rad < options.min_angle_rad) return std::nullopt;
  return best;
}

double EpipolarDistance_px(const geometry::Rigid3& camera2_from_camera1,
                           const Eigen::Vector3d& ray1,
                           const Eigen::Vector3d& ray2,
                           double focal2_px) {
  const Eigen::Vector3d line = camera2_from_camera1.translation.cross(
      camera2_from_camera1.rotation * ray1);
  const double length = line.head<2>().norm();
  if (!(length > 0.0)) return std::numeric_limits<double>::infinity();
  return std::abs(line.dot(ray2)) / length * focal2_px;
}

}  // namespace groundlock::build::internal
