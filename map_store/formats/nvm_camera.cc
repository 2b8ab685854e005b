// SPDX-License-Identifier: Apache-2.0
// Between NVM's distortion (measured to undistorted) and ours (undistorted to
// distorted), by least squares over the image's radius.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "map_store/base/status.h"
#include "map_store/formats/internal/nvm_model.h"
#include "map_store/formats/internal/radial_fit.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;

constexpr double kMaxExportResidual_px = 1.0;

}  // namespace

absl::StatusOr<FittedCamera> CameraFromNvm(
    double focal_px,
    double r,
    int width_px,
    int height_px,
    const Eigen::Vector2d& principal_point_px,
    double radius_px) {
  if (!(focal_px > 0.0) || !std::isfinite(focal_px) || !std::isfinite(r) ||
      !(radius_px > 0.0) || !std::isfinite(radius_px)) {
    return absl::InvalidArgumentError(
        absl::StrCat("focal length ", focal_px, " or distortion ", r));
  }
  double max_measured = radius_px / focal_px;
  if (r < 0.0) {
    // A little inside the fold: at it ours would need an infinite slope.
    max_measured = std::min(max_measured, 0.9 / std::sqrt(-3.0 * r));
  }
  return FitRadialCamera(
      focal_px,
      width_px,
      height_px,
      principal_point_px,
      max_measured * focal_px,
      [&](double measured) {
        return std::pair{(1.0 + r * measured * measured) * measured, measured};
      });
}

absl::StatusOr<FittedNvm> NvmFromCamera(const CameraModel& camera) {
  // Pixels over the whole image, relative to the principal point, and where
  // they point: focal (x, y) = m + r |m|^2 m / f^2 is linear in (f, r / f^2).
  std::vector<Eigen::Vector2d> measured_px;
  std::vector<Eigen::Vector2d> undistorted;
  constexpr int kSteps = 32;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j <= kSteps; ++j) {
      const Eigen::Vector2d pixel(camera.width_px() * i / double{kSteps},
                                  camera.height_px() * j / double{kSteps});
      const auto x = camera.NormalizedFromImage(pixel);
      if (!x) continue;
      measured_px.emplace_back(pixel - camera.principal_point_px());
      undistorted.push_back(*x);
    }
  }
  const auto n = static_cast<Eigen::Index>(measured_px.size());
  if (n < kSteps) {
    return absl::FailedPreconditionError(
        "its image has hardly a pixel that can be undistorted");
  }
  // Unknowns (f, r / f^2 * scale^2), scaled so that both columns are alike.
  const double scale_px = camera.mean_focal_px();
  Eigen::MatrixXd a(2 * n, 2);
  Eigen::VectorXd b(2 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector2d m =
        measured_px[static_cast<std::size_t>(i)] / scale_px;
    a.block<2, 1>(2 * i, 0) = undistorted[static_cast<std::size_t>(i)];
    a.block<2, 1>(2 * i, 1) = -m.squaredNorm() * m;
    b.segment<2>(2 * i) = m;
  }
  const Eigen::Vector2d solution = a.colPivHouseholderQr().solve(b);
  FittedNvm nvm;
  nvm.focal_px = solution(0) * scale_px;
  nvm.r = solution(1) * solution(0) * solution(0);
  nvm.max_residual_px = (a * solution - b).cwiseAbs().maxCoeff() * scale_px;
  if (!(nvm.focal_px > 0.0) || !(nvm.max_residual_px < kMaxExportResidual_px)) {
    return absl::FailedPreconditionError(absl::StrCat(
        "NVM knows one focal length and one distortion coefficient; the best "
        "are ",
        nvm.max_residual_px,
        " px off"));
  }
  return nvm;
}

}  // namespace groundlock::formats::internal
