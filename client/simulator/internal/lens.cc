// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/lens.h"

#include "absl/strings/str_format.h"

namespace groundlock::simulator {
namespace {

constexpr double kFocalPerWidth = 1'050.0 / 1'280.0;
constexpr double kRadial = -0.045;
constexpr double kMinDepth_m = 0.05;

}  // namespace

Lens Lens::ForSize(int width_px, int height_px) {
  return {width_px,
          height_px,
          kFocalPerWidth * width_px,
          0.5 * width_px,
          0.5 * height_px,
          kRadial};
}

Eigen::Vector2d Lens::Undistort(double x_px, double y_px) const {
  const Eigen::Vector2d distorted((x_px - cx) / f, (y_px - cy) / f);
  const double radius = distorted.norm();
  double r = radius;
  // Newton on r + k r^3 = radius: three steps suffice at |k| r^2 < 0.05.
  for (int i = 0; i < 6; ++i) {
    r -= (r + k * r * r * r - radius) / (1.0 + 3.0 * k * r * r);
  }
  return radius > 0.0 ? Eigen::Vector2d(distorted * (r / radius)) : distorted;
}

std::optional<Eigen::Vector2d> Lens::Project(
    const Eigen::Vector3d& p_camera) const {
  if (p_camera.z() < kMinDepth_m) return std::nullopt;
  const Eigen::Vector2d x = p_camera.head<2>() / p_camera.z();
  const double r2 = x.squaredNorm();
  if (1.0 + 3.0 * k * r2 <= 0.0) return std::nullopt;
  const Eigen::Vector2d distorted = (1.0 + k * r2) * x;
  return Eigen::Vector2d(f * distorted.x() + cx, f * distorted.y() + cy);
}

bool Lens::Contains(const Eigen::Vector2d& p_px) const {
  return p_px.x() >= 0.0 && p_px.y() >= 0.0 && p_px.x() < width_px &&
         p_px.y() < height_px;
}

std::string Lens::ToJson() const {
  return absl::StrFormat(
      "{\"width\":%d,\"height\":%d,\"model\":\"SIMPLE_RADIAL\","
      "\"params\":[%.10g,%.10g,%.10g,%.10g]}\n",
      width_px,
      height_px,
      f,
      cx,
      cy,
      k);
}

}  // namespace groundlock::simulator
