// SPDX-License-Identifier: Apache-2.0
#include "server/localization/robust_pose.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "server/localization/pose_refinement.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Vector6d;

constexpr int kMinObservations = 6;
// A step below these changes no pixel by more than a hundredth.
constexpr double kStepTolerance = 1e-6;

// Of the normal matrix scaled to a unit diagonal: pivots below this are
// rounding, not information. The weakest geometry of use, a narrow strip of a
// far wall, leaves 1e-6.
constexpr double kMinPivot = 1e-11;

struct NormalEquations {
  Matrix6d H = Matrix6d::Zero();
  Vector6d b = Vector6d::Zero();
  double weighted_squared_error = 0.0;
  double weight = 0.0;
  int num_inliers = 0;
};

double TukeyWeight(double squared_error, double gate) {
  const double u = squared_error / (gate * gate);
  return u < 1.0 ? (1.0 - u) * (1.0 - u) : 0.0;
}

NormalEquations Linearize(const geometry::CameraModel& camera,
                          std::span<const PoseObservation> observations,
                          const geometry::Rigid3& world_from_camera,
                          double gate_px,
                          bool unit_weights) {
  NormalEquations equations;
  for (const PoseObservation& observation : observations) {
    Eigen::Matrix<double, 2, 6> J;
    const auto residual = ReprojectionResidual(camera,
                                               world_from_camera,
                                               observation.p_world,
                                               observation.pixel_px,
                                               &J);
    if (!residual) continue;
    double weight = TukeyWeight(residual->squaredNorm(), gate_px);
    if (weight <= 0.0) continue;
    weight = observation.weight * (unit_weights ? 1.0 : weight);
    equations.H.noalias() += weight * J.transpose() * J;
    equations.b.noalias() -= weight * J.transpose() * *residual;
    equations.weighted_squared_error += weight * residual->squaredNorm();
    equations.weight += weight;
    ++equations.num_inliers;
  }
  return equations;
}

// Inverse of a normal matrix; nullopt if it leaves a direction open. Metres and
// radians differ in size by orders of magnitude, so the diagonal is scaled
// first: the pivots then compare, whatever the map's unit.
std::optional<Matrix6d> InvertNormalMatrix(const Matrix6d& H) {
  if (!(H.diagonal().minCoeff() > 0.0) || !H.allFinite()) return std::nullopt;
  const Vector6d scale = H.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Matrix6d> solver(scale.asDiagonal() * H *
                                     scale.asDiagonal());
  if (solver.info() != Eigen::Success ||
      !(solver.vectorD().minCoeff() > kMinPivot)) {
    return std::nullopt;
  }
  const Matrix6d inverse = scale.asDiagonal() *
                           solver.solve(Matrix6d::Identity()) *
                           scale.asDiagonal();
  if (!inverse.allFinite()) return std::nullopt;
  return inverse;
}

}  // namespace

std::optional<RobustPose> RefinePoseRobustly(
    const geometry::CameraModel& camera,
    std::span<const PoseObservation> observations,
    const geometry::Rigid3& initial_world_from_camera,
    const RobustPoseOptions& options) {
  geometry::Rigid3 pose = initial_world_from_camera;
  double gate_px = options.initial_gate_px;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    const NormalEquations equations =
        Linearize(camera, observations, pose, gate_px, false);
    if (equations.num_inliers < kMinObservations) return std::nullopt;
    const std::optional<Matrix6d> inverse = InvertNormalMatrix(equations.H);
    if (!inverse) return std::nullopt;
    const Vector6d step = *inverse * equations.b;
    if (!step.allFinite()) return std::nullopt;
    pose.translation += step.head<3>();
    pose.rotation =
        (geometry::QuaternionFromRotationVector(step.tail<3>()) * pose.rotation)
            .normalized();
    const bool narrow = gate_px <= options.final_gate_px;
    if (narrow && step.norm() < kStepTolerance) break;
    gate_px = std::max(options.final_gate_px, 0.5 * gate_px);
  }

  const NormalEquations equations =
      Linearize(camera, observations, pose, options.final_gate_px, true);
  if (equations.num_inliers < kMinObservations) return std::nullopt;
  RobustPose result;
  result.world_from_camera = pose;
  result.num_inliers = equations.num_inliers;
  result.rms_error_px = std::sqrt(equations.weighted_squared_error /
                                  std::max(1e-9, equations.weight));
  const std::optional<Matrix6d> inverse = InvertNormalMatrix(equations.H);
  if (!inverse) return std::nullopt;
  // Two residuals per observation, six parameters.
  const double variance_px2 = equations.weighted_squared_error /
                              std::max(1, 2 * equations.num_inliers - 6);
  result.covariance = variance_px2 * *inverse;

  result.is_inlier.resize(observations.size());
  const geometry::Rigid3 camera_from_world = pose.Inverse();
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const auto pixel =
        camera.ImageFromCamera(camera_from_world * observations[i].p_world);
    if (!pixel) continue;
    const double error_px = (*pixel - observations[i].pixel_px).norm();
    if (!(error_px < options.final_gate_px)) continue;
    result.is_inlier[i] = 1;
    result.mean_error_px += error_px / result.num_inliers;
  }
  return result;
}

}  // namespace groundlock::localization
