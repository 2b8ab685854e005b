// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/brown_lens.h"

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "map_store/base/status.h"
#include "map_store/formats/internal/radial_fit.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

// A tenth of a keypoint's noise.
constexpr double kWarnResidual_px = 0.05;
constexpr int kSamples = 256;

// The radius on z = 1, undistorted, up to which the image reaches and the
// distortion grows.
double MaxRadius(const BrownLens& lens, double measured_radius) {
  double radius = 0.0;
  const double step = measured_radius / kSamples;
  double last = 0.0;
  // Strong barrel distortion: the undistorted radius may be far larger.
  for (int i = 1; i <= 8 * kSamples; ++i) {
    const double u = step * i;
    const double s = u * u;
    const double distorted =
        u * (1.0 + s * (lens.k[0] + s * (lens.k[1] + s * lens.k[2])));
    if (!(distorted > last)) break;
    radius = u;
    last = distorted;
    if (distorted >= measured_radius) break;
  }
  return radius;
}

// k1 and k2 that come nearest to all three, over the image.
std::array<double, 2> FitTwo(const BrownLens& lens, double max_radius) {
  Eigen::MatrixXd a(kSamples, 2);
  Eigen::VectorXd b(kSamples);
  for (int i = 0; i < kSamples; ++i) {
    const double u = max_radius * (i + 1) / kSamples;
    const double s = u * u;
    a(i, 0) = u * s;
    a(i, 1) = u * s * s;
    b(i) = u * s * (lens.k[0] + s * (lens.k[1] + s * lens.k[2]));
  }
  const Eigen::Vector2d k = a.colPivHouseholderQr().solve(b);
  return {k(0), k(1)};
}

double ResidualPx(const BrownLens& lens,
                  const std::array<double, 2>& k,
                  double max_radius) {
  double worst = 0.0;
  for (int i = 1; i <= kSamples; ++i) {
    const double s = std::pow(max_radius * i / kSamples, 2.0);
    const double delta =
        s * (lens.k[0] - k[0] + s * (lens.k[1] - k[1] + s * lens.k[2]));
    worst = std::max(worst, std::abs(delta) * std::sqrt(s));
  }
  return worst * std::max(lens.fx_px, lens.fy_px);
}

}  // namespace

absl::StatusOr<CameraModel> CameraFromBrown(
    const BrownLens& lens,
    int width_px,
    int height_px,
    std::string_view where,
    std::vector<std::string>* warnings) {
  const Eigen::Vector2d& c = lens.principal_point_px;
  const bool one_focal = lens.fx_px == lens.fy_px;
  const bool tangential = lens.p[0] != 0.0 || lens.p[1] != 0.0;
  std::array<double, 2> k = {lens.k[0], lens.k[1]};
  if (lens.k[2] != 0.0 && lens.fx_px > 0.0 && lens.fy_px > 0.0 &&
      std::isfinite(lens.k[2])) {
    const double measured_radius =
        c.cwiseAbs()
            .cwiseMax((Eigen::Vector2d(width_px, height_px) - c).cwiseAbs())
            .norm() /
        std::min(lens.fx_px, lens.fy_px);
    const double max_radius = MaxRadius(lens, measured_radius);
    if (!(max_radius > 0.0)) {
      return absl::InvalidArgumentError(absl::StrCat(
          base::Abseil(where), ": its distortion folds at the centre"));
    }
    double residual_px = 0.0;
    std::optional<CameraModel> camera;
    if (one_focal && !tangential) {
      ASSIGN_OR_RETURN(
          const FittedCamera fitted,
          FitRadialCamera(
              lens.fx_px,
              width_px,
              height_px,
              c,
              max_radius * lens.fx_px,
              [&](double u) {
                const double s = u * u;
                return std::pair{
                    u,
                    u * (1.0 +
                         s * (lens.k[0] + s * (lens.k[1] + s * lens.k[2])))};
              }));
      camera = fitted.camera;
      residual_px = fitted.max_residual_px;
    } else {
      k = FitTwo(lens, max_radius);
      residual_px = ResidualPx(lens, k, max_radius);
    }
    if (residual_px > kWarnResidual_px) {
      warnings->push_back(
          absl::StrCat(base::Abseil(where),
                       ": its distortion could only be converted to within ",
                       residual_px,
                       " px at the border"));
    }
    if (camera) return *camera;
  }
  const auto create = [&](CameraModelId id, std::vector<double> params) {
    auto camera = CameraModel::Create(id, width_px, height_px, params);
    if (camera.ok()) return camera;
    return absl::StatusOr<CameraModel>(base::Annotate(camera.status(), where));
  };
  if (tangential || (!one_focal && (k[0] != 0.0 || k[1] != 0.0))) {
    return create(CameraModelId::kOpenCv,
                  {lens.fx_px,
                   lens.fy_px,
                   c.x(),
                   c.y(),
                   k[0],
                   k[1],
                   lens.p[0],
                   lens.p[1]});
  }
  if (!one_focal) {
    return create(CameraModelId::kPinhole,
                  {lens.fx_px, lens.fy_px, c.x(), c.y()});
  }
  if (k[1] != 0.0) {
    return create(CameraModelId::kRadial,
                  {lens.fx_px, c.x(), c.y(), k[0], k[1]});
  }
  if (k[0] != 0.0) {
    return create(CameraModelId::kSimpleRadial,
                  {lens.fx_px, c.x(), c.y(), k[0]});
  }
  return create(CameraModelId::kSimplePinhole, {lens.fx_px, c.x(), c.y()});
}

}  // namespace groundlock::formats::internal
