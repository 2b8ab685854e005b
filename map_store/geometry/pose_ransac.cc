// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/pose_ransac.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opengv/absolute_pose/CentralAbsoluteAdapter.hpp>
#include <opengv/absolute_pose/methods.hpp>
#include <random>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/geometry/ransac.h"

namespace groundlock::geometry {
namespace {

// Three points fix the pose, the fourth is the first that can contradict it.
constexpr std::size_t kMinInliers = 4;
// Sine of the smallest angle of a triangle or between bearings that still fixes
// a pose: 1e-4 rad is a tenth of a pixel at the usual focal lengths.
constexpr double kMinSine = 1e-4;

bool IsDegenerate(std::span<const Eigen::Vector3d, 3> ray_camera,
                  std::span<const Eigen::Vector3d, 3> p_world) {
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    const int k = (i + 2) % 3;
    if (ray_camera[i].cross(ray_camera[j]).norm() < kMinSine) return true;
    const Eigen::Vector3d a = p_world[j] - p_world[i];
    const Eigen::Vector3d b = p_world[k] - p_world[i];
    // Negated so that a NaN counts as degenerate.
    if (!(a.cross(b).norm() > kMinSine * a.norm() * b.norm())) return true;
  }
  return false;
}

std::optional<double> SquaredError(const CameraModel& camera,
                                   const Rigid3& camera_from_world,
                                   const Eigen::Vector3d& p_world,
                                   const Eigen::Vector2d& pixel_px) {
  const auto projected_px = camera.ImageFromCamera(camera_from_world * p_world);
  if (!projected_px) return std::nullopt;
  return (*projected_px - pixel_px).squaredNorm();
}

// Three points propose up to four poses; those agree that project near their
// pixels.
struct PoseProblem {
  using Model = Rigid3;  // camera_from_world
  struct Support {
    int inliers = 0;
    double squared_error = 0.0;
  };

  const CameraModel& camera;
  std::span<const Eigen::Vector3d> p_world;
  std::span<const Eigen::Vector2d> pixel_px;
  // Pixels that no ray maps to cannot be sampled, nor be inliers.
  std::span<const Eigen::Vector3d> rays;
  std::span<const int> indices;  // of the rays' points
  const PoseRansacOptions& options;

  template <typename Consider>
  void Sample(std::mt19937_64& engine, Consider consider) const {
    // Three different ones.
    std::array<int, 3> sample{};
    for (std::size_t i = 0; i < sample.size(); ++i) {
      std::uniform_int_distribution<int> draw(
          0, static_cast<int>(indices.size()) - 1);
      do {
        sample[i] = draw(engine);
      } while (std::find(sample.begin(), sample.begin() + i, sample[i]) !=
               sample.begin() + i);
    }
    std::array<Eigen::Vector3d, 3> sample_rays;
    std::array<Eigen::Vector3d, 3> sample_points;
    for (std::size_t i = 0; i < sample.size(); ++i) {
      sample_rays[i] = rays[sample[i]];
      sample_points[i] = p_world[indices[sample[i]]];
    }
    for (const Rigid3& pose : SolveP3p(sample_rays, sample_points)) {
      consider(pose);
    }
  }

  // Gives up as soon as `best` can no longer be reached.
  std::optional<Support> SupportOf(const Rigid3& camera_from_world,
                                   const Support* best) const {
    Support support;
    const int n = static_cast<int>(p_world.size());
    const double max_squared_error =
        options.max_error_px * options.max_error_px;
    for (int i = 0; i < n; ++i) {
      if (best != nullptr && support.inliers + (n - i) < best->inliers) {
        return std::nullopt;
      }
      const auto squared_error =
          SquaredError(camera, camera_from_world, p_world[i], pixel_px[i]);
      if (squared_error && *squared_error < max_squared_error) {
        ++support.inliers;
        support.squared_error += *squared_error;
      }
    }
    if (best != nullptr && (support.inliers < best->inliers ||
                            (support.inliers == best->inliers &&
                             !(support.squared_error < best->squared_error)))) {
      return std::nullopt;
    }
    return support;
  }

  int NumSamples(const Support& best) const {
    return NumSamplesFor(
        static_cast<double>(best.inliers) / static_cast<double>(indices.size()),
        3,
        options.confidence,
        options.max_iterations);
  }
};

}  // namespace

absl::Status PoseRansacOptions::Validate() const {
  if (!(max_error_px > 0.0) || !std::isfinite(max_error_px)) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_error_px is ", max_error_px, ", must be positive"));
  }
  if (!(confidence > 0.0 && confidence < 1.0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("confidence is ", confidence, ", must be inside (0, 1)"));
  }
  if (max_iterations < 1) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_iterations is ", max_iterations, ", must be at least 1"));
  }
  return absl::OkStatus();
}

std::vector<Rigid3> SolveP3p(std::span<const Eigen::Vector3d, 3> ray_camera,
                             std::span<const Eigen::Vector3d, 3> p_world) {
  std::vector<Rigid3> solutions;
  if (IsDegenerate(ray_camera, p_world)) return solutions;
  const opengv::bearingVectors_t bearings(ray_camera.begin(), ray_camera.end());
  const opengv::points_t points(p_world.begin(), p_world.end());
  const opengv::absolute_pose::CentralAbsoluteAdapter adapter(bearings, points);
  for (const opengv::transformation_t& world_from_camera :
       opengv::absolute_pose::p3p_kneip(adapter)) {
    // The quartic's complex roots come out as their real parts, or as NaN.
    if (!world_from_camera.allFinite()) continue;
    const Eigen::Matrix3d rotation = world_from_camera.leftCols<3>();
    const Rigid3 pose{Eigen::Quaterniond(rotation).normalized(),
                      world_from_camera.col(3)};
    solutions.push_back(pose.Inverse());
  }
  return solutions;
}

std::vector<int> FindInliers(const CameraModel& camera,
                             const Rigid3& camera_from_world,
                             std::span<const Eigen::Vector3d> p_world,
                             std::span<const Eigen::Vector2d> pixel_px,
                             double max_error_px) {
  std::vector<int> inliers;
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    const auto squared_error =
        SquaredError(camera, camera_from_world, p_world[i], pixel_px[i]);
    if (squared_error && *squared_error < max_error_px * max_error_px) {
      inliers.push_back(static_cast<int>(i));
    }
  }
  return inliers;
}

absl::StatusOr<PoseRansacReport> EstimatePoseRansac(
    const CameraModel& camera,
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector2d> pixel_px,
    const PoseRansacOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  if (p_world.size() != pixel_px.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        p_world.size(), " points but ", pixel_px.size(), " pixels"));
  }
  std::vector<Eigen::Vector3d> rays;
  std::vector<int> indices;
  for (std::size_t i = 0; i < pixel_px.size(); ++i) {
    const auto ray = camera.RayFromImage(pixel_px[i]);
    if (!ray || !p_world[i].allFinite()) continue;
    rays.push_back(*ray);
    indices.push_back(static_cast<int>(i));
  }
  if (indices.size() < kMinInliers) {
    return absl::FailedPreconditionError(absl::StrCat(
        indices.size(), " usable correspondences, a pose needs ", kMinInliers));
  }
  std::mt19937_64 engine(options.seed);
  PoseProblem problem{camera, p_world, pixel_px, rays, indices, options};
  const auto found = Ransac(problem, options.max_iterations, engine);
  if (!found.best ||
      found.best->support.inliers < static_cast<int>(kMinInliers)) {
    return absl::FailedPreconditionError(absl::StrCat("no pose with ",
                                                      kMinInliers,
                                                      " inliers among ",
                                                      indices.size(),
                                                      " correspondences after ",
                                                      found.num_samples,
                                                      " samples"));
  }
  PoseRansacReport report;
  report.camera_from_world = found.best->model;
  report.iterations = found.num_samples;
  report.inliers = FindInliers(camera,
                               report.camera_from_world,
                               p_world,
                               pixel_px,
                               options.max_error_px);
  return report;
}

}  // namespace groundlock::geometry
