// SPDX-License-Identifier: Apache-2.0
// Camera pose from 2D-3D correspondences with outliers: P3P in RANSAC. A
// library of its own (pose_solver): who only needs the rest of geometry, as the
// client library does, links no OpenGV.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_POSE_RANSAC_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_POSE_RANSAC_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::geometry {

struct PoseRansacOptions {
  double max_error_px = 2.0;   // inlier gate in the real, distorted image
  double confidence = 0.9999;  // P(one sample is free of outliers)
  int max_iterations = 1'000;
  std::uint64_t seed = 0;         // caller mixes session and frame ids
  absl::Status Validate() const;  // names field, value and bound
};

struct PoseRansacReport {
  Rigid3 camera_from_world;
  std::vector<int> inliers;  // indices of correspondences, ascending
  int iterations = 0;
};

// Up to four poses (camera_from_world) that see three world points along three
// unit bearings; none if the points are collinear or bearings coincide.
// Source: Kneip, Scaramuzza & Siegwart 2011, as OpenGV implements it.
std::vector<Rigid3> SolveP3p(std::span<const Eigen::Vector3d, 3> ray_camera,
                             std::span<const Eigen::Vector3d, 3> p_world);

// Correspondences that project within max_error_px of their pixel, ascending.
std::vector<int> FindInliers(const CameraModel& camera,
                             const Rigid3& camera_from_world,
                             std::span<const Eigen::Vector3d> p_world,
                             std::span<const Eigen::Vector2d> pixel_px,
                             double max_error_px);

// The pose with the most inliers among samples of three, all solutions of a
// sample being tried; stops once a better one is unlikely (1 - confidence) or
// after max_iterations (Robinson 2014, §3.4; Fischler & Bolles 1981).
//   p_world, pixel_px  N correspondences.
// Deterministic in options.seed. Thread-safe.
// Errors: kInvalidArgument if sizes differ; kFailedPrecondition if N < 4 or no
//   sample gives a pose with at least 4 inliers.
absl::StatusOr<PoseRansacReport> EstimatePoseRansac(
    const CameraModel& camera,
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector2d> pixel_px,
    const PoseRansacOptions& options);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_POSE_RANSAC_H_
