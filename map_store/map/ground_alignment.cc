// SPDX-License-Identifier: Apache-2.0
// The ground of a map without an alignment: where it is, and the transform that
// makes it z = 0.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <random>

#include "absl/strings/str_cat.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/ground.h"
#include "map_store/map/internal/ground_scene.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {
namespace {

using geometry::Plane;
using internal::GroundScene;
using internal::PointsWithin;
using internal::Select;

// Draws of three landmarks. A ground that holds a tenth of the landmarks is hit
// 20 times, and each hypothesis costs microseconds.
constexpr int kHypotheses = 20'000;
// Landmarks that hypotheses are scored on; the share of inliers is then known
// to better than 1 %.
constexpr std::size_t kMaxScored = 4'000;
constexpr std::size_t kMinLandmarks = 30;
// Cameras that must stand on one side of the ground.
constexpr double kMinCamerasAbove = 0.95;
// Half-width of the band of landmarks that the ground is fitted to, in
// tolerances, once it is known.
constexpr double kGroundBand = 0.5;
// The same for the landmarks that the thesis' estimate gets to see.
constexpr double kSeedBand = 1.0;
// Share of the ground's inliers that the seed's neighbourhood should hold.
constexpr double kNeighbourhoodShare = 0.7;

// How far the plane is from what the cameras say about "up", as a factor.
// People and gimbals hold cameras without roll, so the ground's normal is
// perpendicular to their x axes; it points up in the image rather than down (0
// for cameras that look straight down, so that is no proof against). Neither is
// certain: portrait videos have x along gravity. So the factor never vanishes.
double UprightFactor(const GroundScene& scene, const Eigen::Vector3d& normal) {
  double roll_squared = 0.0;
  double up = 0.0;
  for (const Eigen::Matrix3d& camera_from_world : scene.camera_from_world) {
    const Eigen::Vector3d n_camera = camera_from_world * normal;
    roll_squared += n_camera.x() * n_camera.x();
    up -= n_camera.y();
  }
  const auto count = static_cast<double>(scene.camera_from_world.size());
  roll_squared /= count;
  up /= count;
  constexpr double kRollSigma = 0.25;  // sin of 14 degrees: a careless hand
  const double level =
      std::exp(-0.5 * roll_squared / (kRollSigma * kRollSigma));
  const double upright = std::clamp((up + 0.3) / 0.8, 0.05, 1.0);
  return std::max(level, 0.05) * upright;
}

// The plane with its normal towards the cameras, if nearly all are on one side.
std::optional<Plane> TowardsCameras(const GroundScene& scene, Plane plane) {
  std::size_t above = 0;
  for (const Eigen::Vector3d& center : scene.centers) {
    if (plane.SignedDistance(center) > 0.0) ++above;
  }
  const std::size_t count = scene.centers.size();
  if (2 * above < count) {
    plane = plane.Flipped();
    above = count - above;
  }
  if (static_cast<double>(above) <
      kMinCamerasAbove * static_cast<double>(count)) {
    return std::nullopt;
  }
  return plane;
}

// Landmarks on the plane, less half of those below it: nothing is seen through
// the ground, but much is seen below a table, a roof or a slanted plane.
double Support(const GroundScene& scene,
               const Plane& plane,
               std::size_t num_scored) {
  int on = 0;
  int below = 0;
  for (std::size_t i = 0; i < num_scored; ++i) {
    const double distance = plane.SignedDistance(scene.points[i]);
    if (std::abs(distance) < scene.tolerances[i]) {
      ++on;
    } else if (distance < -3.0 * scene.tolerances[i]) {
      ++below;
    }
  }
  return on - 0.5 * below;
}

// How far the plane is from a known "up": slopes of 20 degrees happen.
double LevelFactor(const std::optional<Eigen::Vector3d>& up,
                   const Eigen::Vector3d& normal) {
  if (!up.has_value()) return 1.0;
  constexpr double kSlopeSigma_rad = 0.2;
  constexpr double kMaxSlope_rad = 0.6;  // 34 degrees: no ground to stand on
  const double slope_rad = std::acos(std::clamp(up->dot(normal), -1.0, 1.0));
  if (slope_rad > kMaxSlope_rad) return 0.0;
  return std::exp(-0.5 * std::pow(slope_rad / kSlopeSigma_rad, 2.0));
}

// The best of many planes through three landmarks, fitted to its inliers.
absl::StatusOr<Plane> FindGround(const GroundScene& scene,
                                 std::uint64_t seed,
                                 const std::optional<Eigen::Vector3d>& up) {
  std::mt19937_64 generator(seed);
  const std::size_t count = scene.points.size();
  const auto draw = [&] {
    return static_cast<std::size_t>(((generator() >> 32U) * count) >> 32U);
  };
  const std::size_t num_scored = std::min(kMaxScored, count);
  std::optional<Plane> best;
  double best_score = 0.0;
  for (int round = 0; round < kHypotheses; ++round) {
    const Eigen::Vector3d& a = scene.points[draw()];
    const Eigen::Vector3d ab = scene.points[draw()] - a;
    const Eigen::Vector3d ac = scene.points[draw()] - a;
    const Eigen::Vector3d normal = ab.cross(ac);
    // Slivers (an angle below 6 degrees) determine their plane badly.
    if (!(normal.norm() > 0.1 * ab.norm() * ac.norm())) continue;
    const Eigen::Vector3d unit = normal.normalized();
    const std::optional<Plane> plane =
        TowardsCameras(scene, Plane{unit, -unit.dot(a)});
    if (!plane.has_value()) continue;
    const double upright = up.has_value() ? LevelFactor(up, plane->normal)
                                          : UprightFactor(scene, plane->normal);
    // Not even full support would make it the best.
    if (upright * static_cast<double>(num_scored) <= best_score) continue;
    const double score = upright * Support(scene, *plane, num_scored);
    if (score > best_score) {
      best_score = score;
      best = plane;
    }
  }
  if (!best.has_value()) {
    return absl::FailedPreconditionError(
        "no plane of landmarks lies below the cameras; give an alignment");
  }
  // What stands on the ground is above it and would lift the plane: narrowing
  // the band moves it to where the landmarks are densest.
  for (const double band : {1.0, 0.8, 0.65, kGroundBand, kGroundBand}) {
    const auto refined =
        geometry::FitPlane(Select(scene, PointsWithin(scene, *best, band)));
    if (!refined.ok()) break;
    const auto oriented = TowardsCameras(scene, *refined);
    if (!oriented.has_value()) break;
    best = oriented;
  }
  return *best;
}

double Quantile(std::vector<double> values, double share) {
  const auto middle =
      values.begin() + static_cast<std::ptrdiff_t>(
                           share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The landmark on the ground that is nearest to the middle of all of them, and
// the radius around it that holds most.
struct Seed {
  Eigen::Vector3d point;
  double radius = 0.0;
};
Seed FindSeed(const GroundScene& scene,
              const std::vector<std::size_t>& ground) {
  Eigen::Vector3d middle;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    values.reserve(ground.size());
    for (const std::size_t i : ground) values.push_back(scene.points[i](axis));
    middle(axis) = Quantile(std::move(values), 0.5);
  }
  Seed seed{scene.points[ground.front()], 0.0};
  for (const std::size_t i : ground) {
    const Eigen::Vector3d& point = scene.points[i];
    if ((point - middle).norm() < (seed.point - middle).norm()) {
      seed.point = point;
    }
  }
  std::vector<double> distances;
  distances.reserve(ground.size());
  for (const std::size_t i : ground) {
    distances.push_back((scene.points[i] - seed.point).norm());
  }
  seed.radius = Quantile(std::move(distances), kNeighbourhoodShare);
  return seed;
}

}  // namespace

// x along the projection of the first camera's x axis: a viewer's right. The
// origin is below the middle of the cameras.
geometry::Similarity3 internal::LevelledFromSource(const MapData& data,
                                                   const Plane& ground) {
  const Eigen::Matrix3d camera_from_source =
      data.views.front().camera_from_world.rotation.toRotationMatrix();
  Eigen::Vector3d x_axis = camera_from_source.row(0);
  x_axis -= x_axis.dot(ground.normal) * ground.normal;
  if (x_axis.norm() < 0.1) {  // a camera on its side: its y axis is not
    x_axis = camera_from_source.row(1);
    x_axis -= x_axis.dot(ground.normal) * ground.normal;
  }
  x_axis.normalize();
  Eigen::Matrix3d world_from_source;
  world_from_source.row(0) = x_axis;
  world_from_source.row(1) = ground.normal.cross(x_axis);
  world_from_source.row(2) = ground.normal;

  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  for (const MapViewData& view : data.views) {
    center += view.camera_from_world.Inverse().translation;
  }
  center /= static_cast<double>(data.views.size());
  geometry::Similarity3 result;
  result.rotation = Eigen::Quaterniond(world_from_source).normalized();
  result.translation = -(result.rotation * ground.Project(center));
  return result;
}

absl::StatusOr<GroundEstimate> internal::EstimateGround(
    const MapData& data,
    std::uint64_t seed,
    const std::optional<Eigen::Vector3d>& up) {
  const GroundScene scene = internal::MakeGroundScene(data, seed);
  if (scene.points.size() < kMinLandmarks || scene.centers.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("the ground cannot be estimated from ",
                     scene.points.size(),
                     " landmarks and ",
                     scene.centers.size(),
                     " views: it takes ",
                     kMinLandmarks,
                     " landmarks"));
  }
  ASSIGN_OR_RETURN(const Plane found, FindGround(scene, seed, up));
  const std::vector<std::size_t> on_ground = PointsWithin(scene, found, 1.0);
  if (on_ground.size() < 3) {
    return absl::FailedPreconditionError("too few landmarks on the ground");
  }
  const Seed start = FindSeed(scene, on_ground);

  // Robinson 2014, §3.6.1, on the landmarks around the seed. Its inlier gate is
  // the mean distance of all of them; those that stand clear of the ground
  // (walls, trees) are left out, or they would widen the gate and lift the
  // plane.
  std::vector<Eigen::Vector3d> near_seed;
  for (const std::size_t i : PointsWithin(scene, found, kSeedBand)) {
    if ((scene.points[i] - start.point).norm() <= start.radius) {
      near_seed.push_back(scene.points[i]);
    }
  }
  geometry::PlaneRansacOptions options;
  options.seed = base::MixSeed(seed, 1);
  GroundEstimate estimate;
  estimate.seed_source = start.point;
  estimate.ground_source = found;
  const auto fitted = geometry::FitPlaneRansac(near_seed, options);
  std::optional<Plane> oriented;
  if (fitted.ok()) oriented = TowardsCameras(scene, fitted->plane);
  // A small neighbourhood can tilt the plane: then the one that all landmarks
  // support is the better ground.
  if (oriented.has_value() &&
      Support(scene, *oriented, scene.points.size()) >=
          0.9 * Support(scene, found, scene.points.size())) {
    estimate.ground_source = *oriented;
    estimate.num_inliers = static_cast<int>(fitted->inliers.size());
    estimate.mean_distance = fitted->mean_distance;
  } else {
    estimate.num_inliers = static_cast<int>(on_ground.size());
    for (const std::size_t i : on_ground) {
      estimate.mean_distance += std::abs(found.SignedDistance(scene.points[i]));
    }
    estimate.mean_distance /= static_cast<double>(on_ground.size());
  }
  return estimate;
}

absl::StatusOr<Plane> internal::FitGroundAround(
    const MapData& data,
    const Eigen::Vector3d& seed_point,
    std::uint64_t seed) {
  const GroundScene scene = internal::MakeGroundScene(data, seed);
  if (scene.points.size() < kMinLandmarks || scene.centers.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("the map has only ", scene.points.size(), " landmarks"));
  }
  // A twentieth of the map, but enough for a plane.
  std::vector<std::pair<double, std::size_t>> nearest;
  nearest.reserve(scene.points.size());
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    nearest.emplace_back((scene.points[i] - seed_point).norm(), i);
  }
  const std::size_t count = std::min(
      nearest.size(), std::clamp<std::size_t>(nearest.size() / 20, 30, 1'000));
  std::nth_element(nearest.begin(),
                   nearest.begin() + static_cast<std::ptrdiff_t>(count - 1),
                   nearest.end());
  const double radius = nearest[count - 1].first;
  std::vector<Eigen::Vector3d> near_seed;
  for (std::size_t i = 0; i < count; ++i) {
    near_seed.push_back(scene.points[nearest[i].second]);
  }
  geometry::PlaneRansacOptions options;
  options.seed = base::MixSeed(seed, 2);
  ASSIGN_OR_RETURN(const geometry::PlaneRansacResult fitted,
                   geometry::FitPlaneRansac(near_seed, options));
  Plane plane = fitted.plane;
  // Then all that lies on it within three times as far: the tilt is better
  // known from afar.
  for (int round = 0; round < 3; ++round) {
    std::vector<Eigen::Vector3d> on_plane;
    for (const std::size_t i : PointsWithin(scene, plane, kGroundBand)) {
      if ((scene.points[i] - seed_point).norm() <= 3.0 * radius) {
        on_plane.push_back(scene.points[i]);
      }
    }
    const auto refined = geometry::FitPlane(on_plane);
    if (!refined.ok()) break;
    plane = *refined;
  }
  const auto oriented = TowardsCameras(scene, plane);
  if (!oriented.has_value()) {
    return absl::FailedPreconditionError(
        "the landmarks around the seed lie on a plane that has cameras on both "
        "of its sides");
  }
  return *oriented;
}

absl::StatusOr<GroundEstimate> AlignToEstimatedGround(std::uint64_t seed,
                                                      MapData& data) {
  ASSIGN_OR_RETURN(const GroundEstimate estimate,
                   internal::EstimateGround(data, seed, std::nullopt));
  data.Transform(internal::LevelledFromSource(data, estimate.ground_source));
  data.metric = false;
  data.origin.reset();
  data.ground = Plane{};
  data.in_world = true;
  return estimate;
}

}  // namespace groundlock::map
