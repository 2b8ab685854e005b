// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/plane.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <random>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/geometry/ransac.h"

namespace groundlock::geometry {
namespace {

// Uniform in [0, n), n < 2^32, the same on every platform; the bias of n / 2^32
// is far below what 1000 rounds can show.
std::size_t Draw(std::size_t n, std::mt19937_64& generator) {
  return static_cast<std::size_t>(((generator() >> 32U) * n) >> 32U);
}

// k distinct indices below n in random order (a partial Fisher-Yates shuffle).
std::vector<int> DrawDistinct(std::size_t k,
                              std::size_t n,
                              std::mt19937_64& generator) {
  std::vector<int> indices(n);
  std::iota(indices.begin(), indices.end(), 0);
  for (std::size_t i = 0; i < k; ++i) {
    std::swap(indices[i], indices[i + Draw(n - i, generator)]);
  }
  indices.resize(k);
  return indices;
}

std::optional<Plane> PlaneThrough(const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b,
                                  const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a;
  const Eigen::Vector3d ac = c - a;
  const Eigen::Vector3d normal = ab.cross(ac);
  const double norm = normal.norm();
  // sin of the angle between the edges: below, rounding decides the normal.
  if (!(norm > 1e-10 * ab.norm() * ac.norm())) return std::nullopt;
  return Plane{normal / norm, -normal.dot(a) / norm};
}

// Points as columns of a matrix, so that Eigen vectorises over them.
Eigen::ArrayXd Distances(const Plane& plane, const Eigen::MatrixX3d& points) {
  return ((points * plane.normal).array() + plane.d).abs();
}

absl::Status CheckPoints(std::span<const Eigen::Vector3d> points) {
  if (points.size() < 3) {
    return absl::FailedPreconditionError(
        absl::StrCat("a plane needs at least 3 points, got ", points.size()));
  }
  for (const Eigen::Vector3d& point : points) {
    if (!point.allFinite()) {
      return absl::InvalidArgumentError("a point for the plane is not finite");
    }
  }
  return absl::OkStatus();
}

// Three points propose a plane; those agree with it that are nearer to it than
// the mean.
struct PlaneProblem {
  using Model = Plane;
  using Support = Eigen::Index;

  const Eigen::MatrixX3d& points;

  template <typename Consider>
  void Sample(std::mt19937_64& generator, Consider consider) const {
    const auto count = static_cast<std::size_t>(points.rows());
    const std::size_t i = Draw(count, generator);
    std::size_t j = Draw(count - 1, generator);
    if (j >= i) ++j;
    std::size_t k = Draw(count - 2, generator);
    if (k >= std::min(i, j)) ++k;
    if (k >= std::max(i, j)) ++k;
    const std::optional<Plane> plane =
        PlaneThrough(points.row(static_cast<Eigen::Index>(i)),
                     points.row(static_cast<Eigen::Index>(j)),
                     points.row(static_cast<Eigen::Index>(k)));
    if (plane) consider(*plane);
  }
  std::optional<Support> SupportOf(const Plane& plane,
                                   const Support* best) const {
    const Eigen::ArrayXd distances = Distances(plane, points);
    const Support inliers = (distances < distances.mean()).count();
    if (best != nullptr && inliers <= *best) return std::nullopt;
    return inliers;
  }
};

// The plane of the largest consensus; nullopt if every triple was collinear.
std::optional<Plane> BestOfRounds(const Eigen::MatrixX3d& points,
                                  int rounds,
                                  std::mt19937_64& generator) {
  PlaneProblem problem{points};
  const auto found = Ransac(problem, rounds, generator);
  if (!found.best) return std::nullopt;
  return found.best->model;
}

}  // namespace

PlaneAxes::PlaneAxes(const Plane& plane_world) {
  const Eigen::Vector3d& n = plane_world.normal;
  origin_world = plane_world.Project(Eigen::Vector3d::Zero());
  // World x unless the plane is upright to it.
  Eigen::Vector3d x = Eigen::Vector3d::UnitX() - n.x() * n;
  if (x.norm() < 0.1) x = Eigen::Vector3d::UnitY() - n.y() * n;
  axes_world.col(0) = x.normalized();
  axes_world.col(1) = n.cross(axes_world.col(0));
}

Eigen::Vector2d PlaneAxes::FromWorld(const Eigen::Vector3d& p_world) const {
  return axes_world.transpose() * (p_world - origin_world);
}

Eigen::Vector3d PlaneAxes::ToWorld(const Eigen::Vector2d& p_plane) const {
  return origin_world + axes_world * p_plane;
}

Eigen::Vector3d PlaneAxes::DirectionToWorld(
    const Eigen::Vector2d& v_plane) const {
  return axes_world * v_plane;
}

std::optional<Eigen::Vector3d> IntersectRay(const Plane& plane,
                                            const Eigen::Vector3d& origin,
                                            const Eigen::Vector3d& direction) {
  const double along = plane.normal.dot(direction);
  if (!(std::abs(along) >= 1e-9 * direction.norm()) || along == 0.0) {
    return std::nullopt;
  }
  const double s = -plane.SignedDistance(origin) / along;
  if (!(s > 0.0)) return std::nullopt;
  return origin + s * direction;
}

absl::StatusOr<Plane> FitPlane(std::span<const Eigen::Vector3d> points,
                               std::span<const double> weights) {
  RETURN_IF_ERROR(CheckPoints(points));
  if (!weights.empty() && weights.size() != points.size()) {
    return absl::InvalidArgumentError(absl::StrCat(points.size(),
                                                   " points for a plane with ",
                                                   weights.size(),
                                                   " weights"));
  }
  const auto weight_of = [&weights](std::size_t i) {
    return weights.empty() ? 1.0 : weights[i];
  };
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  double sum = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    mean += weight_of(i) * points[i];
    sum += weight_of(i);
  }
  mean /= sum;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d centered = points[i] - mean;
    scatter += weight_of(i) * centered * centered.transpose();
  }
  // The right singular vectors of the centred points are the eigenvectors of
  // their scatter; eigenvalues (squared singular values) come in rising order.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  const Eigen::Vector3d& variances = solver.eigenvalues();
  if (!(variances(1) > 1e-14 * variances(2))) {
    return absl::FailedPreconditionError(
        "the points for the plane lie on one line");
  }
  const Eigen::Vector3d normal = solver.eigenvectors().col(0).normalized();
  return Plane{normal, -normal.dot(mean)};
}

absl::StatusOr<PlaneRansacResult> FitPlaneRansac(
    std::span<const Eigen::Vector3d> points,
    const PlaneRansacOptions& options) {
  if (options.rounds < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("rounds is ", options.rounds, ", must be at least 1"));
  }
  RETURN_IF_ERROR(CheckPoints(points));
  std::mt19937_64 generator(options.seed);

  Eigen::MatrixX3d all(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i) {
    all.row(static_cast<Eigen::Index>(i)) = points[i];
  }
  std::optional<Plane> best;
  if (points.size() <= PlaneRansacOptions::kMaxSampledPoints) {
    best = BestOfRounds(all, options.rounds, generator);
  } else {
    const std::vector<int> sampled = DrawDistinct(
        PlaneRansacOptions::kMaxSampledPoints, points.size(), generator);
    best = BestOfRounds(all(sampled, Eigen::all), options.rounds, generator);
  }
  if (!best.has_value()) {
    return absl::FailedPreconditionError(
        "the points for the plane lie on one line");
  }

  PlaneRansacResult result;
  const Eigen::ArrayXd distances = Distances(*best, all);
  const double mean_distance = distances.mean();
  std::vector<Eigen::Vector3d> inlier_points;
  for (std::size_t i = 0; i < points.size(); ++i) {
    // Points that all lie on the plane have no distance below their mean: then
    // all of them are its inliers.
    const double distance = distances(static_cast<Eigen::Index>(i));
    if (distance < mean_distance || distance == 0.0) {
      result.inliers.push_back(static_cast<int>(i));
      inlier_points.push_back(points[i]);
    }
  }
  ASSIGN_OR_RETURN(result.plane, FitPlane(inlier_points));
  for (const Eigen::Vector3d& point : inlier_points) {
    result.mean_distance += std::abs(result.plane.SignedDistance(point));
  }
  result.mean_distance /= static_cast<double>(inlier_points.size());
  return result;
}

}  // namespace groundlock::geometry
