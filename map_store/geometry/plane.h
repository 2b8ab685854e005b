// SPDX-License-Identifier: Apache-2.0
// Planes n.x + d = 0 and their estimation from points (Robinson 2014, §3.6.1).
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_PLANE_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_PLANE_H_

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::geometry {

// normal . x + d = 0 with a unit normal; positive distances lie on the side
// that the normal points to (up, for a ground plane).
struct Plane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double d = 0.0;

  double SignedDistance(const Eigen::Vector3d& p) const {
    return normal.dot(p) + d;
  }
  Eigen::Vector3d Project(const Eigen::Vector3d& p) const {
    return p - SignedDistance(p) * normal;
  }
  Plane Flipped() const { return {-normal, -d}; }
};

// Two unit axes that span a plane, and a point on it: for a level one world x
// and y, and the point under the origin.
struct PlaneAxes {
  explicit PlaneAxes(const Plane& plane_world);
  Eigen::Vector2d FromWorld(const Eigen::Vector3d& p_world) const;
  Eigen::Vector3d ToWorld(const Eigen::Vector2d& p_plane) const;
  Eigen::Vector3d DirectionToWorld(const Eigen::Vector2d& v_plane) const;

  Eigen::Vector3d origin_world;
  Eigen::Matrix<double, 3, 2> axes_world;
};

// Where origin + s * direction, s > 0, meets the plane. nullopt if the ray is
// parallel to it (|cos| < 1e-9) or leads away from it.
std::optional<Eigen::Vector3d> IntersectRay(const Plane& plane,
                                            const Eigen::Vector3d& origin,
                                            const Eigen::Vector3d& direction);

// Total least squares: the plane through the mean whose normal is the direction
// of least variance. N >= 3, not collinear (kFailedPrecondition).
//   weights  one per point, positive; empty = all alike.
absl::StatusOr<Plane> FitPlane(std::span<const Eigen::Vector3d> points,
                               std::span<const double> weights = {});

struct PlaneRansacOptions {
  // With more points than this, the rounds run on a random subset of this size
  // (drawn with the seed); the winner's inliers are taken from all points. The
  // share of inliers of a plane then varies by 0.4 % (1 sigma, binomial).
  static constexpr std::size_t kMaxSampledPoints = 20'000;

  int rounds = 1'000;  // unconditionally, as in the thesis
  std::uint64_t seed = 0;
};

struct PlaneRansacResult {
  Plane plane;
  std::vector<int> inliers;    // indices into points
  double mean_distance = 0.0;  // of the inliers to the plane, unit of points
};

// Robinson 2014, §3.6.1: in each round a plane through three random points;
// inliers lie nearer than the round's mean distance over all points; the
// largest set is fitted by FitPlane. The sign of the normal is arbitrary.
// kFailedPrecondition with fewer than three points or all on one line,
// kInvalidArgument if a point is not finite.
absl::StatusOr<PlaneRansacResult> FitPlaneRansac(
    std::span<const Eigen::Vector3d> points, const PlaneRansacOptions& options);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_PLANE_H_
