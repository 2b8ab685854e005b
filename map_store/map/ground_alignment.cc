// SPDX-License-Identifier: Apache-2.0
// The ground of a map without an alignment: where it is, and the transform that
// makes it z = 0.
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <random>

#include "absl/strings/str_cat.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/order_statistics.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/chosen_ground.h"
#include "map_store/map/internal/ground.h"
#include "map_store/map/internal/ground_fit.h"
#include "map_store/map/internal/ground_scene.h"
#include "map_store/map/internal/ground_support.h"
#include "map_store/map/internal/up_evidence.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {
namespace {

using geometry::Plane;
using internal::GroundScene;
using internal::kGroundBand;
using internal::Narrowed;
using internal::PointsWithin;
using internal::Select;
using internal::TowardsCameras;
using internal::UpEvidence;

// Draws of three landmarks. A ground that holds a tenth of the landmarks is hit
// 20 times, and each hypothesis costs microseconds.
constexpr int kHypotheses = 20'000;
// Landmarks that hypotheses are scored on; the share of inliers is then known
// to better than 1 %.
constexpr std::size_t kMaxScored = 4'000;
constexpr std::size_t kMinLandmarks = 30;
// Half-width, in tolerances, of the band of landmarks that the thesis' estimate
// gets to see.
constexpr double kSeedBand = 1.0;
// Planes with this share of the best one's score are kept as alternatives, one
// of each direction (about 5 degrees), and so many of them.
constexpr double kReckonedWith = 0.25;
constexpr double kCell = 0.09;
constexpr std::size_t kMaxAlternatives = 40;
// Directions nearer than this are the same plane.
constexpr double kSamePlane_rad = 0.026;
// Weight of an alternative: exp(-kSharpness * (1 - its share of the score)).
// One with half the score weighs 1/400, so that at 90 degrees it adds 4.5.
constexpr double kSharpness = 12.0;
// Ground is not flat to better than that where nobody levelled it.
constexpr double kUneven_rad = 0.5 * std::numbers::pi / 180.0;
// Below: nothing stands on it.
constexpr double kMaxSigma_rad = 2.0 * std::numbers::pi / 180.0;
constexpr double kLeastShare = 0.04;
constexpr double kLeastEvidence = -3.0;
constexpr double kMaxHeightSigma = 0.12;  // of the cameras' height
constexpr double kFrontal = 0.9;          // cosine: within 26 degrees
constexpr double kLeastTurn_rad = 0.35;   // 20 degrees
// Two estimates differ by less if they are of one ground: three of the largest
// sigma that is still sure.
constexpr double kOtherGround_rad = 3.0 * kMaxSigma_rad;
// Share of the ground's inliers that the seed's neighbourhood should hold.
constexpr double kNeighbourhoodShare = 0.7;

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

// A plane that landmarks support, and how much speaks for it.
struct Hypothesis {
  Plane plane;
  double score = 0.0;
};

// Scores planes through three landmarks, and keeps the best of each direction.
class GroundSearch {
 public:
  GroundSearch(const GroundScene& scene,
               const std::optional<Eigen::Vector3d>& up)
      : scene_(scene),
        up_(up),
        evidence_(scene.camera_from_world),
        num_scored_(std::min(kMaxScored, scene.points.size())) {}

  const UpEvidence& evidence() const { return evidence_; }

  double Score(const Plane& plane) const {
    return UprightFactor(plane.normal) * Support(scene_, plane, num_scored_);
  }

  void Draw(std::uint64_t seed) {
    std::mt19937_64 generator(seed);
    const std::size_t count = scene_.points.size();
    const auto draw = [&] {
      return static_cast<std::size_t>(((generator() >> 32U) * count) >> 32U);
    };
    double best_score = 0.0;
    for (int round = 0; round < kHypotheses; ++round) {
      const Eigen::Vector3d& a = scene_.points[draw()];
      const Eigen::Vector3d ab = scene_.points[draw()] - a;
      const Eigen::Vector3d ac = scene_.points[draw()] - a;
      const Eigen::Vector3d normal = ab.cross(ac);
      // Slivers (an angle below 6 degrees) determine their plane badly.
      if (!(normal.norm() > 0.1 * ab.norm() * ac.norm())) continue;
      const Eigen::Vector3d unit = normal.normalized();
      const std::optional<Plane> plane =
          TowardsCameras(scene_, Plane{unit, -unit.dot(a)});
      if (!plane.has_value()) continue;
      const double upright = UprightFactor(plane->normal);
      // Not even full support would make it one to reckon with.
      const double least = kReckonedWith * best_score;
      if (upright * static_cast<double>(num_scored_) <= least) continue;
      const double score = upright * Support(scene_, *plane, num_scored_);
      if (score <= least) continue;
      best_score = std::max(best_score, score);
      Keep({*plane, score});
    }
  }

  // The best one first, each fitted to its inliers.
  std::vector<Hypothesis> Finish() const {
    std::vector<Hypothesis> found;
    for (const auto& [cell, hypothesis] : best_of_) {
      found.push_back(hypothesis);
    }
    std::stable_sort(
        found.begin(), found.end(), [](const auto& a, const auto& b) {
          return a.score > b.score;
        });
    if (found.size() > kMaxAlternatives) found.resize(kMaxAlternatives);
    for (Hypothesis& hypothesis : found) {
      const Plane narrowed = Narrowed(scene_, hypothesis.plane);
      const double score = Score(narrowed);
      // Narrowing is for the plane's place, not to win.
      hypothesis.plane = narrowed;
      hypothesis.score = std::max(score, 0.0);
    }
    std::stable_sort(
        found.begin(), found.end(), [](const auto& a, const auto& b) {
          return a.score > b.score;
        });
    return found;
  }

 private:
  // A factor of at least 1/150: nothing is excluded but by a known up.
  double UprightFactor(const Eigen::Vector3d& normal) const {
    if (up_.has_value()) return LevelFactor(up_, normal);
    return std::max(std::exp(evidence_.LogOf(normal)), 1.0 / 150.0);
  }

  void Keep(const Hypothesis& hypothesis) {
    const Eigen::Vector3d& n = hypothesis.plane.normal;
    const std::array<int, 3> cell = {
        static_cast<int>(std::floor(n.x() / kCell)),
        static_cast<int>(std::floor(n.y() / kCell)),
        static_cast<int>(std::floor(n.z() / kCell))};
    const auto [it, is_new] = best_of_.emplace(cell, hypothesis);
    if (!is_new && hypothesis.score > it->second.score) {
      it->second = hypothesis;
    }
  }

  const GroundScene& scene_;
  const std::optional<Eigen::Vector3d>& up_;
  const UpEvidence evidence_;
  const std::size_t num_scored_;
  std::map<std::array<int, 3>, Hypothesis> best_of_;
};

double AngleBetween_rad(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// How sure the best plane's tilt is, against the next best explanations, and
// what speaks against standing anything on it.
void Judge(const GroundScene& scene,
           const GroundSearch& search,
           const std::vector<Hypothesis>& found,
           bool up_is_known,
           GroundEstimate& estimate) {
  const Plane& best = estimate.ground_source;
  const double best_score = search.Score(best);
  const internal::GroundSpread fit = internal::SpreadOfFit(scene, best);
  // Other planes, by how nearly as well they do.
  double weights = 1.0;
  double spread = 0.0;
  for (const Hypothesis& other : found) {
    const double angle = AngleBetween_rad(other.plane.normal, best.normal);
    if (angle < kSamePlane_rad) continue;
    const double weight =
        std::exp(kSharpness * (std::min(1.0, other.score / best_score) - 1.0));
    weights += weight;
    spread += weight * angle * angle;
  }
  estimate.sigma_rad =
      std::sqrt(kUneven_rad * kUneven_rad + fit.tilt_rad * fit.tilt_rad +
                spread / weights);
  const double parallel =
      !(best_score > 0.0)
          ? 1.0
          : internal::HeightSigmaShare(scene, best, [&](const Plane& plane) {
              const double share_of_score =
                  std::min(1.0, search.Score(plane) / best_score);
              return std::exp(kSharpness * (share_of_score - 1.0));
            });
  const double height = internal::MeanHeight(scene, best);
  estimate.height = height;
  // A ground that is uneven, or tilted, between what is seen of it and the
  // place below the cameras.
  estimate.height_sigma =
      std::hypot(fit.height, estimate.sigma_rad * fit.lever, parallel * height);
  const auto share =
      static_cast<double>(PointsWithin(scene, best, 1.0).size()) /
      static_cast<double>(scene.points.size());
  const UpEvidence& evidence = search.evidence();
  if (!(best_score > 0.0) || share < kLeastShare) {
    estimate.doubt = "hardly any landmarks lie on one plane below the cameras";
  } else if (!internal::StandsOut(scene, best)) {
    estimate.doubt =
        "the lowest plane below the cameras only cuts through what stands on "
        "the ground (walls, trunks), which itself hardly shows";
  } else if (parallel > kMaxHeightSigma) {
    estimate.doubt =
        "planes at several heights explain the landmarks about as well";
  } else if (!up_is_known && evidence.LogOf(best.normal) < kLeastEvidence) {
    estimate.doubt =
        "the plane that most landmarks lie on is not level in the pictures";
  } else if (!up_is_known && evidence.LooksAlong(best.normal) > kFrontal &&
             evidence.SpreadAbout_rad(best.normal) < kLeastTurn_rad) {
    estimate.doubt =
        "all cameras look straight at the plane that the landmarks lie on and "
        "never turn: it may be a wall as well as the ground";
  } else if (estimate.sigma_rad > kMaxSigma_rad) {
    estimate.doubt = "several planes explain the landmarks about as well";
  }
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
    middle(axis) = base::Quantile(std::move(values), 0.5);
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
  seed.radius = base::Quantile(std::move(distances), kNeighbourhoodShare);
  return seed;
}

// Errors and `up` as EstimateGround's; the data's measured_up does not count.
absl::StatusOr<GroundEstimate> EstimateGroundOf(
    const GroundScene& scene,
    std::uint64_t seed,
    const std::optional<Eigen::Vector3d>& up) {
  GroundSearch search(scene, up);
  search.Draw(seed);
  const std::vector<Hypothesis> hypotheses = search.Finish();
  if (hypotheses.empty() || !(hypotheses.front().score > 0.0)) {
    return absl::FailedPreconditionError(
        "no plane of landmarks lies below the cameras; give an alignment");
  }
  const Plane found = hypotheses.front().plane;
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
  // support is the better ground. Where up is known it may even be a wall's,
  // which has more landmarks than the ground at its foot.
  if (oriented.has_value() &&
      (!up ||
       AngleBetween_rad(oriented->normal, found.normal) <= kOtherGround_rad) &&
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
  estimate.ground_source = Narrowed(scene, estimate.ground_source);
  Judge(scene, search, hypotheses, up.has_value(), estimate);
  return estimate;
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
  if (up || !data.measured_up) return EstimateGroundOf(scene, seed, up);
  // What is measured is believed where the map is in doubt. Where it is not,
  // one of the two is wrong, and nobody knows which.
  auto estimate = EstimateGroundOf(scene, seed, data.measured_up->up_world);
  auto alone = EstimateGroundOf(scene, seed, std::nullopt);
  if (alone.ok() && alone->doubt.empty()) {
    const bool is_same =
        estimate.ok() &&
        AngleBetween_rad(estimate->ground_source.normal,
                         alone->ground_source.normal) <= kOtherGround_rad;
    estimate = std::move(alone);
    if (!is_same) {
      estimate->doubt =
          absl::StrCat("the plane that most landmarks lie on is not where ",
                       data.measured_up->basis,
                       " have the ground");
    }
  }
  if (estimate.ok()) estimate->up_basis = data.measured_up->basis;
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

double GroundEstimate::height_sigma_share() const {
  const double share = height_sigma / height;
  return height > 0.0 && std::isfinite(share) ? share : 0.0;
}

absl::StatusOr<GroundEstimate> AlignToEstimatedGround(std::uint64_t seed,
                                                      MapData& data) {
  ASSIGN_OR_RETURN(const GroundEstimate estimate,
                   internal::EstimateGround(data, seed, std::nullopt));
  // An unknown ground tells no up either.
  Plane level = estimate.ground_source;
  if (!estimate.doubt.empty() && data.measured_up) {
    const Eigen::Vector3d& up = data.measured_up->up_world;
    level = Plane{up, -up.dot(level.Project(internal::MiddleOfCameras(data)))};
  }
  data.Transform(internal::LevelledFromSource(data, level));
  data.metric = false;
  data.origin.reset();
  data.ground = Plane{};
  data.ground_state =
      estimate.doubt.empty() ? GroundState::kEstimated : GroundState::kUnknown;
  data.ground_sigma_rad = estimate.sigma_rad;
  data.ground_height_sigma = estimate.height_sigma_share();
  data.in_world = true;
  return estimate;
}

}  // namespace groundlock::map
