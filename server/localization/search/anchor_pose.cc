// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchor_pose.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "server/localization/search/feature_errors.h"
#include "server/localization/search/landmark_uncertainty.h"
#include "server/localization/solvers/pose_refinement.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;

// Of a SIFT keypoint, the best of them.
constexpr double kFeatureError_px = 0.4;
constexpr double kLeastGate_px = 1.0;
// Matches of one place share a blur, a texture's parallax, a neighbour's wrong
// match: what they tell has so many times the standard deviation that they
// would have as independent ones (f in docs/method.md). Chosen so that what is
// said of the errors fits them on sim/lot (docs/benchmarks.md, Frame rates).
constexpr double kMatchDependence = 1.13;
// Of the residuals, however uncertain the landmarks are said to be.
constexpr double kMinFeatureShare = 0.25;
// What all landmarks in view have in common: the map is bent, its lens is not
// quite the camera's. Measured on a map by structure from motion (sim/lot); one
// whose views lie where they truly were does without.
constexpr double kBendOverDistance = 7e-5;  // of the mean landmark distance
constexpr double kBend_rad = 1.0e-4;

}  // namespace

std::optional<AnchorPose> RefineAnchorPose(
    const map::Map& map,
    const geometry::CameraModel& camera,
    std::span<const LandmarkMatch> matches,
    const geometry::Rigid3& initial_world_from_camera) {
  // The landmarks' own errors, as they project at the initial pose.
  const Eigen::Matrix3d camera_from_world =
      initial_world_from_camera.rotation.conjugate().toRotationMatrix();
  std::vector<PoseObservation> observations;
  std::vector<Eigen::Matrix2d> landmark_px2;
  observations.reserve(matches.size());
  landmark_px2.reserve(matches.size());
  double distance = 0.0;
  for (const LandmarkMatch& match : matches) {
    const Eigen::Vector3d p_world = map.landmarks()[match.landmark].Position();
    const Eigen::Vector3d offset =
        p_world - initial_world_from_camera.translation;
    Eigen::Matrix<double, 2, 3> d_pixel = Eigen::Matrix<double, 2, 3>::Zero();
    camera.ImageFromCamera(camera_from_world * offset, &d_pixel);
    const Eigen::Matrix<double, 2, 3> d_world = d_pixel * camera_from_world;
    landmark_px2.push_back(d_world * LandmarkCovariance(map, match.landmark) *
                           d_world.transpose());
    const double variance_px2 = 0.5 * landmark_px2.back().trace();
    observations.push_back(
        {p_world,
         match.pixel_px,
         kFeatureError_px * kFeatureError_px /
             (kFeatureError_px * kFeatureError_px + variance_px2)});
    distance += offset.norm();
  }
  RobustPoseOptions options;
  options.initial_gate_px = kFeatureGate_px;
  options.final_gate_px = kFeatureGate_px;
  options.least_gate_px = kLeastGate_px;

  auto pose = RefinePoseRobustly(
      camera, observations, initial_world_from_camera, options);
  if (!pose) return std::nullopt;

  // Sandwich: H^-1 (sum of w^2 J' V J) H^-1, V being what each match's residual
  // is made of.
  Matrix6d H = Matrix6d::Zero();
  Matrix6d by_landmarks = Matrix6d::Zero();
  Matrix6d by_features = Matrix6d::Zero();
  double squared_px2 = 0.0;
  double expected_px2 = 0.0;
  double weight = 0.0;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    if (pose->is_inlier[i] == 0) continue;
    const PoseObservation& observation = observations[i];
    Eigen::Matrix<double, 2, 6> J;
    const auto residual = ReprojectionResidual(camera,
                                               pose->world_from_camera,
                                               observation.p_world,
                                               observation.pixel_px,
                                               &J);
    if (!residual) continue;
    const double w = observation.weight;
    H.noalias() += w * J.transpose() * J;
    by_landmarks.noalias() += w * w * J.transpose() * landmark_px2[i] * J;
    by_features.noalias() += w * w * J.transpose() * J;
    squared_px2 += w * residual->squaredNorm();
    expected_px2 += w * landmark_px2[i].trace();
    weight += w;
  }
  const Eigen::LDLT<Matrix6d> solver(H);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Matrix6d inverse = solver.solve(Matrix6d::Identity());
  if (!inverse.allFinite()) return std::nullopt;
  // What the landmarks do not explain of the residuals is the features'; per
  // axis, six of them spent on the pose.
  const double feature_px2 =
      std::max(kMinFeatureShare * squared_px2, squared_px2 - expected_px2) /
      std::max(1e-9, 2.0 * weight) * pose->num_inliers /
      std::max(1, pose->num_inliers - 3);
  const double factor = kMatchDependence * kMatchDependence;
  AnchorPose result;
  result.measured.world_from_camera = pose->world_from_camera;
  result.measured.random =
      factor * feature_px2 * inverse * by_features * inverse;
  result.measured.systematic = factor * inverse * by_landmarks * inverse;
  distance /= static_cast<double>(std::max<std::size_t>(1, matches.size()));
  result.measured.systematic.diagonal().head<3>().array() +=
      std::pow(kBendOverDistance * distance, 2);
  result.measured.systematic.diagonal().tail<3>().array() +=
      std::pow(kBend_rad, 2);
  result.pose = *std::move(pose);
  return result;
}

double SharedLandmarks(std::span<const std::uint32_t> a,
                       std::span<const std::uint32_t> b) {
  std::size_t shared = 0;
  for (std::size_t i = 0, j = 0; i < a.size() && j < b.size();) {
    if (a[i] == b[j]) {
      ++shared;
      ++i;
      ++j;
    } else if (a[i] < b[j]) {
      ++i;
    } else {
      ++j;
    }
  }
  const std::size_t size = std::max(a.size(), b.size());
  return size == 0 ? 0.0
                   : static_cast<double>(shared) / static_cast<double>(size);
}

std::vector<std::uint32_t> LandmarksOf(std::span<const LandmarkMatch> matches) {
  std::vector<std::uint32_t> landmarks;
  landmarks.reserve(matches.size());
  for (const LandmarkMatch& match : matches) {
    landmarks.push_back(match.landmark);
  }
  std::sort(landmarks.begin(), landmarks.end());
  return landmarks;
}

}  // namespace groundlock::localization
