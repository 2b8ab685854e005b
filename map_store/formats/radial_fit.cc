// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/radial_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

constexpr int kNumSamples = 256;
// Below this a conversion is not worth another parameter: a tenth of the noise
// of a SIFT keypoint.
constexpr double kGoodResidual_px = 0.05;

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

absl::StatusOr<FittedCamera> FitRadialCamera(
    double focal_px,
    int width_px,
    int height_px,
    const Eigen::Vector2d& principal_point_px,
    double radius_px,
    const std::function<std::pair<double, double>(double)>& pair_at) {
  std::vector<RadiusPair> pairs(kNumSamples);
  for (int i = 0; i < kNumSamples; ++i) {
    const double at = radius_px / focal_px * (i + 1) / kNumSamples;
    const auto [undistorted, measured] = pair_at(at);
    pairs[static_cast<std::size_t>(i)] = {undistorted, measured};
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
      best = {*camera, residual_px, radius_px};
    }
    if (best.max_residual_px < kGoodResidual_px) break;
  }
  if (!std::isfinite(best.max_residual_px)) return failure;
  return best;
}

}  // namespace groundlock::formats::internal
