// SPDX-License-Identifier: Apache-2.0
#include "server/movers/point_motion.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kMaxSightings = 16;
constexpr int kSteps = 3;
// The depth is this uncertain before anything is seen, in inverse depths of the
// ground: it says nothing, but keeps a camera that stands solvable.
constexpr double kInverseDepthPrior = 20.0;
// Rays that meet the ground farther than so many camera heights away are taken
// to miss it, as in ground_model.h.
constexpr double kMaxRangeOverHeight = 300.0;

// d (coordinates on z = 1) / d (p_camera).
Eigen::Matrix<double, 2, 3> Projection(const Vector3d& p_camera,
                                       const Vector2d& xy) {
  Eigen::Matrix<double, 2, 3> jacobian;
  jacobian << 1.0, 0.0, -xy.x(), 0.0, 1.0, -xy.y();
  return jacobian / p_camera.z();
}

// Of a sighting of p_world: its own noise, and the pose's.
Matrix2d SightingCovariance(const KeyView& view,
                            const Matrix3d& camera_from_world,
                            const Vector3d& p_world,
                            double sigma) {
  const Vector3d from_camera = p_world - view.world_from_camera.translation;
  const Vector3d p_camera = camera_from_world * from_camera;
  Matrix2d covariance = Matrix2d::Identity() * (sigma * sigma);
  if (!(p_camera.z() > 1e-9)) return covariance;
  const Eigen::Matrix<double, 2, 3> by_shift =
      -Projection(p_camera, p_camera.head<2>() / p_camera.z()) *
      camera_from_world;
  Eigen::Matrix<double, 2, 6> jacobian;
  jacobian << by_shift, -by_shift * geometry::Skew(from_camera);
  covariance += jacobian * view.covariance * jacobian.transpose();
  return covariance;
}

// Where the ray through a sighting meets the plane: the way along (x, y, 1), in
// depths; not positive if it does not.
double DepthOfGround(const KeyView& view,
                     const Vector3d& direction_world,
                     const geometry::Plane& plane_world) {
  const double height =
      plane_world.SignedDistance(view.world_from_camera.translation);
  const double falls = -plane_world.normal.dot(direction_world);
  if (!(falls * kMaxRangeOverHeight > direction_world.norm())) return 0.0;
  return height / falls;
}

Vector3d DirectionWorld(const KeyView& view, const Vector2d& xy) {
  return view.world_from_camera.rotation * xy.homogeneous();
}

}  // namespace

RestFit FitRest(std::span<const Sighting> sightings,
                std::span<const KeyView> views,
                const LocalGround& ground,
                const PointNoise& noise) {
  RestFit fit;
  const std::size_t count = std::min(sightings.size(), kMaxSightings);
  if (count < 2) return fit;
  sightings = sightings.last(count);
  const Sighting& newest = sightings.back();
  const KeyView& now = views[newest.view];
  const double height_m =
      ground.plane_world.SignedDistance(now.world_from_camera.translation);
  if (!(height_m > 0.0)) return fit;
  const Matrix3d world_from_now = now.world_from_camera.rotation.matrix();
  const Vector3d normal_now =
      world_from_now.transpose() * ground.plane_world.normal;
  // A point of inverse depth r seen at (x, y) is n.(x, y, 1) / r + height over
  // the ground: r is at least that of the ground there, or 0 above the horizon.
  const auto ground_inverse_depth = [&](const Vector2d& xy) {
    return std::max(0.0, -normal_now.dot(xy.homogeneous()) / height_m);
  };
  const double start_inverse_depth = ground_inverse_depth(newest.xy);
  // For the noise by the pose any place near the true one does.
  const double some_depth =
      1.0 / std::max(start_inverse_depth, 0.05 / height_m);
  const Vector3d p_world = now.world_from_camera.translation +
                           some_depth * DirectionWorld(now, newest.xy);

  struct Row {
    Matrix3d rotation;  // view from the newest camera
    Vector3d translation;
    Matrix2d information;
  };
  std::array<Row, kMaxSightings> rows;
  for (std::size_t i = 0; i < count; ++i) {
    const KeyView& view = views[sightings[i].view];
    const Matrix3d camera_from_world =
        view.world_from_camera.rotation.matrix().transpose();
    rows[i].rotation = camera_from_world * world_from_now;
    rows[i].translation =
        camera_from_world * (now.world_from_camera.translation -
                             view.world_from_camera.translation);
    rows[i].information =
        SightingCovariance(view, camera_from_world, p_world, noise.sigma)
            .inverse();
  }

  Vector3d x(newest.xy.x(), newest.xy.y(), start_inverse_depth);
  const double prior_sigma =
      kInverseDepthPrior * std::max(start_inverse_depth, 0.05 / height_m);
  const double ground_sigma = std::max(start_inverse_depth, 0.01 / height_m) *
                              std::max(ground.height_sigma_m / height_m, 1e-4);
  // First where it pleases, then, if that is under the ground, held up.
  bool held_up = false;
  const auto normal_equations = [&](Matrix3d* A, Vector3d* b) {
    double chi2 = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      const Row& row = rows[i];
      const Vector3d p =
          row.rotation * x.head<2>().homogeneous() + x.z() * row.translation;
      if (!(p.z() > 1e-6)) return -1.0;
      const Vector2d seen = p.head<2>() / p.z();
      const Vector2d error = sightings[i].xy - seen;
      chi2 += error.dot(row.information * error);
      if (A == nullptr) continue;
      Matrix3d moved;
      moved << row.rotation.leftCols<2>(), row.translation;
      const Eigen::Matrix<double, 2, 3> J = Projection(p, seen) * moved;
      const Eigen::Matrix<double, 3, 2> JtW = J.transpose() * row.information;
      *A += JtW * J;
      *b += JtW * error;
    }
    if (held_up) {
      const double error = ground_inverse_depth(x.head<2>()) - x.z();
      const double weight = 1.0 / (ground_sigma * ground_sigma);
      chi2 += weight * error * error;
      if (A != nullptr) {
        (*A)(2, 2) += weight;
        (*b)(2) += weight * error;
      }
    }
    return chi2;
  };
  for (int round = 0; round < 2; ++round) {
    for (int step = 0; step < kSteps; ++step) {
      Matrix3d A = Matrix3d::Zero();
      Vector3d b = Vector3d::Zero();
      A(2, 2) = 1.0 / (prior_sigma * prior_sigma);
      if (normal_equations(&A, &b) < 0.0) break;
      const Vector3d change = A.ldlt().solve(b);
      if (!change.allFinite()) break;
      x += change;
    }
    if (x.z() >= ground_inverse_depth(x.head<2>())) break;
    held_up = true;
  }
  fit.chi2 = normal_equations(nullptr, nullptr);
  if (!(fit.chi2 >= 0.0)) return {};
  fit.degrees = static_cast<int>(2 * count) - 3;
  fit.inverse_depth = std::max(0.0, x.z());
  return fit;
}

GroundMotion FitGroundMotion(std::span<const Sighting> sightings,
                             std::span<const KeyView> views,
                             const LocalGround& ground,
                             const PointNoise& noise,
                             double change_per_s) {
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  GroundMotion motion;
  const std::size_t count = std::min(sightings.size(), kMaxSightings);
  if (count < 3) return motion;
  sightings = sightings.last(count);
  const geometry::PlaneAxes axes(ground.plane_world);
  const double now_s = views[sightings.back().view].time_s;
  // Unknown: place, velocity and acceleration.
  Matrix6 A = Matrix6::Zero();
  Vector6 b = Vector6::Zero();
  double squares = 0.0;
  std::optional<Vector2d> origin;
  for (const Sighting& sighting : sightings) {
    const KeyView& view = views[sighting.view];
    const Vector3d direction = DirectionWorld(view, sighting.xy);
    const double depth = DepthOfGround(view, direction, ground.plane_world);
    if (!(depth > 0.0)) return motion;
    const Matrix3d world_from_camera = view.world_from_camera.rotation.matrix();
    const Vector3d p_world =
        view.world_from_camera.translation + depth * direction;
    const Vector3d& normal = ground.plane_world.normal;
    const Matrix3d along_ground =
        Matrix3d::Identity() -
        direction * normal.transpose() / normal.dot(direction);
    const Matrix2d place_by_xy = axes.axes_world.transpose() * along_ground *
                                 (depth * world_from_camera.leftCols<2>());
    const Matrix2d covariance =
        place_by_xy *
        SightingCovariance(
            view, world_from_camera.transpose(), p_world, noise.sigma) *
        place_by_xy.transpose();
    const Matrix2d information = covariance.inverse();
    if (!information.allFinite()) return motion;
    // Counted from one of them, so that squares keep their digits.
    if (!origin) origin = axes.FromWorld(p_world);
    const Vector2d place = axes.FromWorld(p_world) - *origin;
    const double t_s = view.time_s - now_s;
    Eigen::Matrix<double, 2, 6> J;
    J << Matrix2d::Identity(), t_s * Matrix2d::Identity(),
        0.5 * t_s * t_s * Matrix2d::Identity();
    const Eigen::Matrix<double, 6, 2> JtW = J.transpose() * information;
    A += JtW * J;
    b += JtW * place;
    squares += place.dot(information * place);
  }
  const Eigen::Vector4d steady =
      A.topLeftCorner<4, 4>().ldlt().solve(b.head<4>());
  const double change = std::max(1e-12, change_per_s * steady.tail<2>().norm());
  A.bottomRightCorner<2, 2>() += Matrix2d::Identity() / (change * change);
  const Matrix6 covariance = A.inverse();
  const Vector6 solved = covariance * b;
  if (!covariance.allFinite() || !solved.allFinite()) return motion;
  motion.chi2 = std::max(0.0, squares - solved.dot(b));
  motion.degrees = static_cast<int>(2 * count) - 4;
  motion.place_m = *origin + solved.head<2>();
  motion.velocity_m_s = solved.segment<2>(2);
  motion.covariance = covariance.topLeftCorner<4, 4>();
  return motion;
}

double ChiSquareAt(int degrees, double z) {
  const double ninth = 2.0 / (9.0 * degrees);
  const double root = 1.0 - ninth + z * std::sqrt(ninth);
  return degrees * root * root * root;
}

}  // namespace groundlock::movers
