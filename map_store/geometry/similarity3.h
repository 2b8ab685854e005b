// SPDX-License-Identifier: Apache-2.0
// Similarity transforms: how a map without scale becomes metres.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_SIMILARITY3_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_SIMILARITY3_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>

#include "absl/status/statusor.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::geometry {

// target_from_source: x_target = scale * rotation * x_source + translation.
struct Similarity3 {
  double scale = 1.0;  // > 0
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Similarity3 Inverse() const;
  bool IsFinite() const;
};

Eigen::Vector3d operator*(const Similarity3& target_from_source,
                          const Eigen::Vector3d& p_source);
Similarity3 operator*(const Similarity3& c_from_b, const Similarity3& b_from_a);

// The pose of a camera after its world has been transformed: the camera frame
// keeps its axes, its unit of length becomes the target's.
// Returns camera_from_target for camera_from_source.
Rigid3 TransformCameraFromWorld(const Similarity3& target_from_source,
                                const Rigid3& camera_from_source);

// Least-squares target_from_source for paired points, N >= 3, not collinear.
// kInvalidArgument on sizes, kFailedPrecondition on degenerate points.
// Source: Umeyama 1991.
absl::StatusOr<Similarity3> EstimateSimilarity(
    std::span<const Eigen::Vector3d> p_source,
    std::span<const Eigen::Vector3d> p_target);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_SIMILARITY3_H_
