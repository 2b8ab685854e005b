// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/robust_pose.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "server/localization/solvers/normal_matrix.h"
#include "server/localization/solvers/pose_estimate.h"
#include "server/localization/solvers/pose_refinement.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Vector6d;

constexpr int kMinObservations = 6;
// A step below these changes no pixel by more than a hundredth.
constexpr double kStepTolerance = 1e-6;
// Tukey's biweight is 95 % as good as least squares with a gate of so many
// standard deviations.
constexpr double kGateOverSigma = 4.685;

// What the observations were weighted by when a pose was solved for, and the
// inverse of its normal matrix.
struct Solved {
  std::vector<double> weights;
  Matrix6d inverse;
};

// The squared residual, in px^2, as if the observation had no part in where the
// pose is. A landmark that alone tells of one direction of the pose leaves
// hardly a residual, wherever it is seen: with the weight w that it had and
// G = J H^-1 J', a residual's variance is 1 - w G times the observation's own.
// Source: Cook & Weisberg 1982, section 2.2 (studentized residuals); Handschin,
// Schweppe, Kohlas & Fiechter 1975 (weights by them).
double StudentizedSquared(const Eigen::Vector2d& residual,
                          const Eigen::Matrix<double, 2, 6>& J,
                          double weight,
                          const Matrix6d& inverse) {
  // Nothing but the observation may tell of a direction: then nothing speaks
  // against it, and what rounding leaves of a residual must not either.
  constexpr double kRounding = 1e-6;
  const Eigen::Matrix2d left =
      (1.0 + kRounding) * Eigen::Matrix2d::Identity() -
      weight * (J * inverse).lazyProduct(J.transpose());
  return residual.dot(left.inverse() * residual);
}

struct NormalEquations {
  Matrix6d H = Matrix6d::Zero();
  Vector6d b = Vector6d::Zero();
  double weighted_squared_error = 0.0;
  double weight = 0.0;
  int num_inliers = 0;
};

// `weights`: of the observations, out. `before`: if given, observations are
// judged by where the others put them.
NormalEquations Linearize(const geometry::CameraModel& camera,
                          std::span<const PoseObservation> observations,
                          const geometry::Rigid3& world_from_camera,
                          double gate_px,
                          bool unit_weights,
                          const Solved* before,
                          std::vector<double>& weights) {
  NormalEquations equations;
  weights.assign(observations.size(), 0.0);
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const PoseObservation& observation = observations[i];
    Eigen::Matrix<double, 2, 6> J;
    const auto residual = ReprojectionResidual(camera,
                                               world_from_camera,
                                               observation.p_world,
                                               observation.pixel_px,
                                               &J);
    if (!residual) continue;
    double squared_px2 = residual->squaredNorm();
    if (before != nullptr) {
      squared_px2 = StudentizedSquared(*residual,
                                       J,
                                       observation.weight * before->weights[i],
                                       before->inverse);
      if (!(squared_px2 >= 0.0)) continue;
    }
    weights[i] = TukeyWeight(squared_px2, gate_px);
    if (weights[i] <= 0.0) continue;
    if (unit_weights) weights[i] = 1.0;
    const double weight = observation.weight * weights[i];
    equations.H.noalias() += weight * J.transpose() * J;
    equations.b.noalias() -= weight * J.transpose() * *residual;
    equations.weighted_squared_error += weight * residual->squaredNorm();
    equations.weight += weight;
    ++equations.num_inliers;
  }
  return equations;
}

// The gate for residuals as they are; their median length is 1.177 standard
// deviations.
double GateOfResiduals(const geometry::CameraModel& camera,
                       std::span<const PoseObservation> observations,
                       const geometry::Rigid3& world_from_camera,
                       const RobustPoseOptions& options) {
  constexpr double kGateOverMedian = kGateOverSigma / 1.177;
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<double> errors_px;
  errors_px.reserve(observations.size());
  for (const PoseObservation& observation : observations) {
    const auto pixel =
        camera.ImageFromCamera(camera_from_world * observation.p_world);
    if (!pixel) continue;
    const double error_px = (*pixel - observation.pixel_px).norm();
    if (error_px < options.final_gate_px) errors_px.push_back(error_px);
  }
  if (errors_px.empty()) return options.final_gate_px;
  const auto middle =
      errors_px.begin() + static_cast<std::ptrdiff_t>(errors_px.size() / 2);
  std::nth_element(errors_px.begin(), middle, errors_px.end());
  return std::clamp(
      kGateOverMedian * *middle, options.least_gate_px, options.final_gate_px);
}

// Pulls towards what is expected, as strong as an observation with the standard
// deviation that `gate_px` stands for.
void AddExpected(const ExpectedPose& expected,
                 const geometry::Rigid3& world_from_camera,
                 const Matrix6d& information,
                 double gate_px,
                 NormalEquations& equations) {
  const double sigma_px = gate_px / kGateOverSigma;
  const Matrix6d weight = sigma_px * sigma_px * information;
  equations.H += weight;
  equations.b.noalias() +=
      weight * PoseDifference(world_from_camera, expected.world_from_camera);
}

// Where the iterations have come.
struct Iterated {
  geometry::Rigid3 world_from_camera;
  double gate_px = 0.0;  // of the next one
  double last_gate_px = 0.0;
};

// Until the steps are short or there were enough. False: too few observations,
// or they leave a direction open. `solved`: if given, each observation is
// judged by where the others put it, once there is a first solution; out.
bool Iterate(const geometry::CameraModel& camera,
             std::span<const PoseObservation> observations,
             const RobustPoseOptions& options,
             const std::optional<ExpectedPose>& expected,
             bool adapts,
             Solved* solved,
             Iterated& at) {
  std::optional<Matrix6d> information;
  if (expected) information = InvertNormalMatrix(expected->covariance);
  std::vector<double> weights;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    const bool by_others = solved != nullptr && iteration > 0;
    NormalEquations equations = Linearize(camera,
                                          observations,
                                          at.world_from_camera,
                                          at.gate_px,
                                          false,
                                          by_others ? solved : nullptr,
                                          weights);
    if (equations.num_inliers < kMinObservations) return false;
    if (information) {
      AddExpected(
          *expected, at.world_from_camera, *information, at.gate_px, equations);
    }
    const std::optional<Matrix6d> inverse = InvertNormalMatrix(equations.H);
    if (!inverse) return false;
    const Vector6d step = *inverse * equations.b;
    if (!step.allFinite()) return false;
    at.world_from_camera = MovePose(at.world_from_camera, step);
    if (solved != nullptr) {
      solved->inverse = *inverse;
      std::swap(solved->weights, weights);
    }
    const bool narrow = at.gate_px <= at.last_gate_px;
    if (narrow && adapts) {
      at.last_gate_px =
          GateOfResiduals(camera, observations, at.world_from_camera, options);
      adapts = false;
    } else if (narrow && step.norm() < kStepTolerance &&
               (solved == nullptr || by_others)) {
      break;
    }
    at.gate_px = std::max(at.last_gate_px, 0.5 * at.gate_px);
  }
  return true;
}

}  // namespace

std::optional<RobustPose> RefinePoseRobustly(
    const geometry::CameraModel& camera,
    std::span<const PoseObservation> observations,
    const geometry::Rigid3& initial_world_from_camera,
    const RobustPoseOptions& options) {
  Iterated at{initial_world_from_camera,
              options.initial_gate_px,
              options.final_gate_px};
  if (!Iterate(camera,
               observations,
               options,
               options.expected,
               options.least_gate_px > 0.0,
               nullptr,
               at)) {
    return std::nullopt;
  }
  Solved solved;
  const bool by_others = options.expected.has_value();
  if (by_others) {
    at.gate_px = at.last_gate_px;
    if (!Iterate(
            camera, observations, options, std::nullopt, false, &solved, at)) {
      return std::nullopt;
    }
  }
  const geometry::Rigid3& pose = at.world_from_camera;
  std::vector<double> weights;
  const NormalEquations equations = Linearize(camera,
                                              observations,
                                              pose,
                                              at.last_gate_px,
                                              true,
                                              by_others ? &solved : nullptr,
                                              weights);
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
    if (!pixel || weights[i] <= 0.0) continue;
    result.is_inlier[i] = 1;
    result.mean_error_px +=
        (*pixel - observations[i].pixel_px).norm() / result.num_inliers;
  }
  return result;
}

}  // namespace groundlock::localization
