// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/bundle_adjustment.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <thread>

#include "absl/strings/str_cat.h"

namespace groundlock::build::internal {
namespace {

// A pose is (dp, dtheta) of its camera centre and orientation against where it
// started: world_from_camera = (p + dp, Exp(dtheta) R). Steps are small, and
// priors then are plain.
class ReprojectionCost final : public ceres::SizedCostFunction<2, 6, 3> {
 public:
  ReprojectionCost(const geometry::CameraModel& camera,
                   const geometry::Rigid3& world_from_camera,
                   const Eigen::Vector2d& pixel_px,
                   double weight)
      : camera_(camera),
        world_from_camera_(world_from_camera),
        pixel_px_(pixel_px),
        weight_(weight) {}

  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Eigen::Vector3d> dp(parameters[0]);
    const Eigen::Map<const Eigen::Vector3d> dtheta(parameters[0] + 3);
    const Eigen::Map<const Eigen::Vector3d> p_world(parameters[1]);
    const Eigen::Matrix3d camera_from_start =
        world_from_camera_.rotation.conjugate().toRotationMatrix();
    const Eigen::Matrix3d undo =
        geometry::QuaternionFromRotationVector(-dtheta).toRotationMatrix();
    const Eigen::Vector3d from_center =
        p_world - world_from_camera_.translation - dp;
    const Eigen::Vector3d turned = undo * from_center;
    Eigen::Matrix<double, 2, 3> projection;
    const auto pixel =
        camera_.ImageFromCamera(camera_from_start * turned, &projection);
    if (!pixel) return false;
    Eigen::Map<Eigen::Vector2d>(residuals).noalias() =
        weight_ * (*pixel - pixel_px_);
    if (jacobians == nullptr) return true;
    const Eigen::Matrix<double, 2, 3> by_turned =
        weight_ * projection * camera_from_start;
    using Matrix23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
    using Matrix26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Matrix26> by_pose(jacobians[0]);
      by_pose.leftCols<3>() = -by_turned * undo;
      // d Exp(-dtheta) v / d dtheta = [Exp(-dtheta) v]x Jl(-dtheta).
      by_pose.rightCols<3>() =
          by_turned * geometry::Skew(turned) * LeftJacobian(-dtheta);
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Matrix23>(jacobians[1]).noalias() = by_turned * undo;
    }
    return true;
  }

 private:
  // Barfoot 2017, eq. 7.77b.
  static Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& v) {
    const double angle = v.norm();
    const Eigen::Matrix3d K = geometry::Skew(v);
    if (angle < 1e-6) return Eigen::Matrix3d::Identity() + 0.5 * K;
    const double a2 = angle * angle;
    return Eigen::Matrix3d::Identity() + (1.0 - std::cos(angle)) / a2 * K +
           (angle - std::sin(angle)) / (a2 * angle) * K * K;
  }

  const geometry::CameraModel camera_;
  const geometry::Rigid3 world_from_camera_;
  const Eigen::Vector2d pixel_px_;
  const double weight_;
};

// residual = parameter / sigma.
class PriorCost final : public ceres::SizedCostFunction<6, 6> {
 public:
  PriorCost(double sigma_m, double sigma_rad) {
    weights_.head<3>().setConstant(sigma_m > 0.0 ? 1.0 / sigma_m : 0.0);
    weights_.tail<3>().setConstant(sigma_rad > 0.0 ? 1.0 / sigma_rad : 0.0);
  }
  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Eigen::Matrix<double, 6, 1>> offset(parameters[0]);
    Eigen::Map<Eigen::Matrix<double, 6, 1>> weighted(residuals);
    weighted = weights_.cwiseProduct(offset);
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> J(jacobians[0]);
      J = weights_.asDiagonal();
    }
    return true;
  }

 private:
  Eigen::Matrix<double, 6, 1> weights_;
};

class CancelCallback final : public ceres::IterationCallback {
 public:
  explicit CancelCallback(const std::function<bool()>& is_cancelled)
      : is_cancelled_(is_cancelled) {}
  ceres::CallbackReturnType operator()(
      const ceres::IterationSummary& /*summary*/) override {
    if (is_cancelled_ && is_cancelled_()) {
      cancelled_ = true;
      return ceres::SOLVER_ABORT;
    }
    return ceres::SOLVER_CONTINUE;
  }
  bool cancelled() const { return cancelled_; }

 private:
  const std::function<bool()>& is_cancelled_;
  bool cancelled_ = false;
};

}  // namespace

absl::Status AdjustMap(std::span<const PosePrior> priors,
                       const AdjustmentOptions& options,
                       map::MapData* data) {
  if (priors.size() != data->views.size() ||
      (!options.landmark_is_fixed.empty() &&
       options.landmark_is_fixed.size() != data->landmarks.size())) {
    return absl::InvalidArgumentError(
        "priors: not one per view, or landmark_is_fixed: not one per landmark");
  }
  std::vector<std::array<double, 6>> poses(data->views.size());
  std::vector<geometry::Rigid3> starts;
  ceres::Problem problem;
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    const map::MapViewData& view = data->views[v];
    poses[v].fill(0.0);
    starts.push_back(view.camera_from_world.Inverse());
    bool is_observing = false;
    for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
      // What neither side can change only costs time.
      if (priors[v].is_fixed && !options.landmark_is_fixed.empty() &&
          options.landmark_is_fixed[view.landmarks[i]]) {
        continue;
      }
      is_observing = true;
      problem.AddResidualBlock(
          new ReprojectionCost(data->cameras[view.camera],
                               starts[v],
                               view.keypoints_px[i].cast<double>(),
                               1.0 / options.sigma_px),
          new ceres::CauchyLoss(options.robust_px / options.sigma_px),
          poses[v].data(),
          data->landmarks[view.landmarks[i]].p_world.data());
    }
    if (!is_observing) continue;
    if (priors[v].is_fixed) {
      problem.SetParameterBlockConstant(poses[v].data());
    } else if (priors[v].sigma_m > 0.0 || priors[v].sigma_rad > 0.0) {
      problem.AddResidualBlock(
          new PriorCost(priors[v].sigma_m, priors[v].sigma_rad),
          nullptr,
          poses[v].data());
    }
  }
  for (std::size_t i = 0; i < options.landmark_is_fixed.size(); ++i) {
    double* const p_world = data->landmarks[i].p_world.data();
    if (options.landmark_is_fixed[i] && problem.HasParameterBlock(p_world)) {
      problem.SetParameterBlockConstant(p_world);
    }
  }
  if (problem.NumResidualBlocks() == 0) return absl::OkStatus();
  CancelCallback cancel(options.is_cancelled);
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::SPARSE_SCHUR;
  solver.max_num_iterations = options.max_iterations;
  solver.num_threads =
      options.threads > 0
          ? options.threads
          : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  solver.logging_type = ceres::SILENT;
  solver.callbacks.push_back(&cancel);
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  if (cancel.cancelled()) return absl::CancelledError("cancelled");
  if (!summary.IsSolutionUsable()) {
    return absl::InternalError(
        absl::StrCat("bundle adjustment failed: ", summary.message));
  }
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    const Eigen::Map<const Eigen::Vector3d> dp(poses[v].data());
    const Eigen::Map<const Eigen::Vector3d> dtheta(poses[v].data() + 3);
    const geometry::Rigid3 adjusted = {
        (geometry::QuaternionFromRotationVector(dtheta) * starts[v].rotation)
            .normalized(),
        starts[v].translation + dp};
    data->views[v].camera_from_world = adjusted.Inverse();
  }
  return absl::OkStatus();
}

}  // namespace groundlock::build::internal
