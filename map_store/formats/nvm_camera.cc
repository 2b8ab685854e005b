// SPDX-License-Identifier: Apache-2.0
// Between NVM's distortion (measured to undistorted) and ours (undistorted to
// distorted), by least squares over the image's radius.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "map_store/base/status.h"
#include "map_store/formats/internal/nvm_model.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

constexpr int kNumSamples = 256;
// Below this a conversion is not worth another parameter: a tenth of the noise
// of a SIFT keypoint.
constexpr double kGoodResidual_px = 0.05;
constexpr double kMaxExportResidual_px = 1.0;

// One radius on z = 1: where the undistorted point is, where it is measured.
struct RadiusPair {
  double undistorted = 0.0;
  double measured = 0.0;
};

// Coefficients k of measured = base (1 + k1 s^2 + k2 s^4 + ...), s = base =
// undistorted for the radial models and its angle for the fisheye: linear in k.
Eigen::VectorXd FitCoefficients(const std::vector<RadiusPair>& pairs,
                                bool fisheye,
                                int num_coefficients) {
  Eigen::MatrixXd a(static_cast<Eigen::Index>(pairs.size()), num_coefficients);
  Eigen::VectorXd b(a.rows());
  for (Eigen::Index i = 0; i < a.rows(); ++i) {
    const RadiusPair& pair = pairs[static_cast<std::size_t>(i)];
    const double base =
        fisheye ? std::atan(pair.undistorted) : pair.undistorted;
    double power = base;
    for (int j = 0; j < num_coefficients; ++j) {
      power *= base * base;
      a(i, j) = power;
    }
    b(i) = pair.measured - base;
  }
  return a.colPivHouseholderQr().solve(b);
}

// The largest distance, in pixels, of the camera from what the pairs say.
double MaxResidualPx(const CameraModel& camera,
                     double focal_px,
                     const std::vector<RadiusPair>& pairs) {
  double max_residual_px = 0.0;
  for (const RadiusPair& pair : pairs) {
    const auto pixel = camera.ImageFromCamera({pair.undistorted, 0.0, 1.0});
    if (!pixel) return std::numeric_limits<double>::infinity();
    const double measured_px = pixel->x() - camera.principal_point_px().x();
    max_residual_px = std::max(
        max_residual_px, std::abs(measured_px - focal_px * pair.measured));
  }
  return max_residual_px;
}

absl::StatusOr<CameraModel> MakeCamera(CameraModelId id,
                                       double focal_px,
                                       int width_px,
                                       int height_px,
                                       const Eigen::Vector2d& center_px,
                                       const Eigen::VectorXd& k) {
  std::vector<double> params = {focal_px};
  if (id == CameraModelId::kOpenCvFisheye) params.push_back(focal_px);
  params.push_back(center_px.x());
  params.push_back(center_px.y());
  params.insert(params.end(), k.begin(), k.end());
  return CameraModel::Create(id, width_px, height_px, params);
}

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
  std::vector<RadiusPair> pairs(kNumSamples);
  for (int i = 0; i < kNumSamples; ++i) {
    const double d = max_measured * (i + 1) / kNumSamples;
    pairs[static_cast<std::size_t>(i)] = {(1.0 + r * d * d) * d, d};
  }
  struct Candidate {
    CameraModelId id;
    int num_coefficients;
  };
  constexpr Candidate kCandidates[] = {{CameraModelId::kSimpleRadial, 1},
                                       {CameraModelId::kRadial, 2},
                                       {CameraModelId::kOpenCvFisheye, 4}};
  FittedCamera best;
  best.max_residual_px = std::numeric_limits<double>::infinity();
  absl::Status failure =
      absl::InvalidArgumentError("no camera model fits its distortion");
  for (const auto& [id, num_coefficients] : kCandidates) {
    const Eigen::VectorXd k = FitCoefficients(
        pairs, id == CameraModelId::kOpenCvFisheye, num_coefficients);
    const auto camera =
        MakeCamera(id, focal_px, width_px, height_px, principal_point_px, k);
    if (!camera.ok()) {
      failure = camera.status();
      continue;
    }
    const double residual_px = MaxResidualPx(*camera, focal_px, pairs);
    if (residual_px < best.max_residual_px) {
      best = {*camera, residual_px, max_measured * focal_px};
    }
    if (best.max_residual_px < kGoodResidual_px) break;
  }
  if (!std::isfinite(best.max_residual_px)) return failure;
  return best;
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
