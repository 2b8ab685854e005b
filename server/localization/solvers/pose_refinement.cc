// SPDX-License-Identifier: Apache-2.0
#include "server/localization/solvers/pose_refinement.h"

#include <ceres/ceres.h>

#include <Eigen/Eigenvalues>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::localization {
namespace {

using geometry::CameraModel;
using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;

constexpr std::size_t kMinPoints = 4;  // one more than fixes the pose

// Left Jacobian of SO(3): Exp(v + dv) = Exp(LeftJacobian(v) dv) Exp(v).
// Source: Sola, Deray & Atchuthan 2018, eq. 145.
Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  const Eigen::Matrix3d skew = geometry::Skew(v);
  if (angle < 1e-6) {
    // The terms left out are of order angle^2 / 6, below the rounding error.
    return Eigen::Matrix3d::Identity() + 0.5 * skew;
  }
  const double squared = angle * angle;
  return Eigen::Matrix3d::Identity() +
         (1.0 - std::cos(angle)) / squared * skew +
         (angle - std::sin(angle)) / (squared * angle) * skew * skew;
}

Rigid3 Displace(const Rigid3& world_from_camera, const Vector6d& delta) {
  return {(geometry::QuaternionFromRotationVector(delta.tail<3>()) *
           world_from_camera.rotation)
              .normalized(),
          world_from_camera.translation + delta.head<3>()};
}

// The residual as a function of the displacement (dp, dtheta) from the initial
// pose, a plain vector space: no manifold is needed.
class ReprojectionCost final : public ceres::SizedCostFunction<2, 6> {
 public:
  ReprojectionCost(const CameraModel& camera,
                   const Rigid3& initial_world_from_camera,
                   const Eigen::Vector3d& p_world,
                   const Eigen::Vector2d& pixel_px)
      : camera_(camera),
        initial_(initial_world_from_camera),
        p_world_(p_world),
        pixel_px_(pixel_px) {}

  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Vector6d> delta(parameters[0]);
    const bool wants_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    Eigen::Matrix<double, 2, 6> jacobian;
    const auto residual =
        ReprojectionResidual(camera_,
                             Displace(initial_, delta),
                             p_world_,
                             pixel_px_,
                             wants_jacobian ? &jacobian : nullptr);
    if (!residual) return false;  // Ceres rejects the step
    Eigen::Map<Eigen::Vector2d>{residuals} = *residual;
    if (wants_jacobian) {
      jacobian.rightCols<3>() *= LeftJacobian(delta.tail<3>());
      Eigen::Map<Eigen::Matrix<double, 2, 6, Eigen::RowMajor>>{jacobians[0]} =
          jacobian;
    }
    return true;
  }

 private:
  const CameraModel& camera_;
  const Rigid3& initial_;
  Eigen::Vector3d p_world_;
  Eigen::Vector2d pixel_px_;
};

absl::StatusOr<ceres::Solver::Summary> Minimize(
    const CameraModel& camera,
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector2d> pixel_px,
    const Rigid3& initial_world_from_camera,
    const PoseRefinementOptions& options,
    Vector6d& delta) {
  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::CauchyLoss loss(options.loss_scale_px);
  ceres::Problem problem(problem_options);
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    problem.AddResidualBlock(
        std::make_unique<ReprojectionCost>(
            camera, initial_world_from_camera, p_world[i], pixel_px[i])
            .release(),
        &loss,
        delta.data());
  }
  ceres::Solver::Options solver_options;
  solver_options.linear_solver_type = ceres::DENSE_QR;
  solver_options.max_num_iterations = options.max_iterations;
  solver_options.logging_type = ceres::SILENT;
  solver_options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(solver_options, &problem, &summary);
  if (!summary.IsSolutionUsable() || !delta.allFinite()) {
    return absl::FailedPreconditionError(
        absl::StrCat("pose refinement failed: ", summary.message));
  }
  return summary;
}

// With loss rho(s) of the squared residual s, and N residuals of two rows,
//   cov = kappa (J'J)^-1,
//   kappa = [sum rho'^2 s / (2N - 6)] / [mean (rho' + s rho'')]^2;
// for rho(s) = s this is the usual least-squares estimate. Cauchy's
// rho' = 1 / (1 + s / c^2) and rho' + s rho'' = rho'^2, so kappa is finite.
absl::Status EstimateCovariance(const CameraModel& camera,
                                std::span<const Eigen::Vector3d> p_world,
                                std::span<const Eigen::Vector2d> pixel_px,
                                double loss_scale_px,
                                RefinedPose& pose) {
  Matrix6d information = Matrix6d::Zero();
  double sum_psi = 0.0;
  double sum_slope = 0.0;
  double sum_error_px = 0.0;
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    Eigen::Matrix<double, 2, 6> jacobian;
    const auto residual = ReprojectionResidual(
        camera, pose.world_from_camera, p_world[i], pixel_px[i], &jacobian);
    if (!residual) {
      return absl::FailedPreconditionError(
          "a landmark does not project at the refined pose");
    }
    const double s = residual->squaredNorm();
    const double weight = 1.0 / (1.0 + s / (loss_scale_px * loss_scale_px));
    information += jacobian.transpose() * jacobian;
    sum_psi += weight * weight * s;
    sum_slope += weight * weight;
    sum_error_px += std::sqrt(s);
  }
  const double n = static_cast<double>(p_world.size());
  const double mean_slope = sum_slope / n;
  const double kappa = sum_psi / (2.0 * n - 6.0) / (mean_slope * mean_slope);
  pose.mean_error_px = sum_error_px / n;

  // Scaled to a unit diagonal, so that the test does not depend on units: a
  // direction of less than 1e-12 of the rest's information is not observed.
  const Vector6d scale = information.diagonal().cwiseSqrt();
  if (!(scale.minCoeff() > 0.0)) {
    return absl::FailedPreconditionError("the points do not fix the pose");
  }
  const Vector6d inverse_scale = scale.cwiseInverse();
  const Matrix6d normalized =
      inverse_scale.asDiagonal() * information * inverse_scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(normalized);
  if (eigen.info() != Eigen::Success || !(eigen.eigenvalues()(0) > 1e-12)) {
    return absl::FailedPreconditionError("the points do not fix the pose");
  }
  const Matrix6d inverse = eigen.eigenvectors() *
                           eigen.eigenvalues().cwiseInverse().asDiagonal() *
                           eigen.eigenvectors().transpose();
  pose.covariance = kappa * (inverse_scale.asDiagonal() * inverse *
                             inverse_scale.asDiagonal());
  return absl::OkStatus();
}

}  // namespace

std::optional<Eigen::Vector2d> ReprojectionResidual(
    const CameraModel& camera,
    const Rigid3& world_from_camera,
    const Eigen::Vector3d& p_world,
    const Eigen::Vector2d& pixel_px,
    Eigen::Matrix<double, 2, 6>* jacobian) {
  const Eigen::Matrix3d camera_from_world =
      world_from_camera.rotation.conjugate().toRotationMatrix();
  const Eigen::Vector3d offset_world = p_world - world_from_camera.translation;
  Eigen::Matrix<double, 2, 3> d_pixel;
  const auto projected_px =
      camera.ImageFromCamera(camera_from_world * offset_world,
                             jacobian != nullptr ? &d_pixel : nullptr);
  if (!projected_px) return std::nullopt;
  if (jacobian != nullptr) {
    // p_camera = R' Exp(-dtheta) (X - p - dp), and
    // Exp(-dtheta) v = v + [v]x dtheta to first order.
    const Eigen::Matrix<double, 2, 3> d_world = d_pixel * camera_from_world;
    jacobian->leftCols<3>() = -d_world;
    jacobian->rightCols<3>() = d_world * geometry::Skew(offset_world);
  }
  return *projected_px - pixel_px;
}

absl::Status PoseRefinementOptions::Validate() const {
  if (!(loss_scale_px > 0.0) || !std::isfinite(loss_scale_px)) {
    return absl::InvalidArgumentError(
        absl::StrCat("loss_scale_px is ", loss_scale_px, ", must be positive"));
  }
  if (max_iterations < 1) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_iterations is ", max_iterations, ", must be at least 1"));
  }
  return absl::OkStatus();
}

absl::StatusOr<RefinedPose> RefinePose(
    const CameraModel& camera,
    std::span<const Eigen::Vector3d> p_world,
    std::span<const Eigen::Vector2d> pixel_px,
    const Rigid3& initial_world_from_camera,
    const PoseRefinementOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  if (p_world.size() != pixel_px.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        p_world.size(), " points but ", pixel_px.size(), " pixels"));
  }
  if (p_world.size() < kMinPoints) {
    return absl::FailedPreconditionError(absl::StrCat(
        p_world.size(), " correspondences, refinement needs ", kMinPoints));
  }
  Vector6d delta = Vector6d::Zero();
  ASSIGN_OR_RETURN(const ceres::Solver::Summary summary,
                   Minimize(camera,
                            p_world,
                            pixel_px,
                            initial_world_from_camera,
                            options,
                            delta));
  RefinedPose pose;
  pose.world_from_camera = Displace(initial_world_from_camera, delta);
  pose.iterations = static_cast<int>(summary.iterations.size());
  RETURN_IF_ERROR(EstimateCovariance(
      camera, p_world, pixel_px, options.loss_scale_px, pose));
  return pose;
}

}  // namespace groundlock::localization
