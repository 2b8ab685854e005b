// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/similarity3.h"

#include <Eigen/SVD>
#include <cmath>
#include <cstddef>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace groundlock::geometry {
namespace {

// True if the points span no plane: their second singular value vanishes
// against the first. 1e-9 lies far above rounding (1e-16 times the points'
// offset from the origin) for any scene and far below what a real one shows.
bool AreCollinear(const Eigen::Matrix3Xd& points) {
  const Eigen::Vector3d mean = points.rowwise().mean();
  const Eigen::Matrix3d scatter =
      (points.colwise() - mean) * (points.colwise() - mean).transpose();
  const Eigen::Vector3d variances =
      Eigen::JacobiSVD<Eigen::Matrix3d>(scatter).singularValues();
  // Singular values of the scatter are squares.
  return !(variances(1) > 1e-18 * variances(0)) || !(variances(0) > 0.0);
}

}  // namespace

Similarity3 Similarity3::Inverse() const {
  const Eigen::Quaterniond inverse = rotation.conjugate();
  return {1.0 / scale, inverse, -(inverse * translation) / scale};
}

bool Similarity3::IsFinite() const {
  return std::isfinite(scale) && rotation.coeffs().allFinite() &&
         translation.allFinite();
}

Eigen::Vector3d operator*(const Similarity3& target_from_source,
                          const Eigen::Vector3d& p_source) {
  return target_from_source.scale * (target_from_source.rotation * p_source) +
         target_from_source.translation;
}

Similarity3 operator*(const Similarity3& c_from_b,
                      const Similarity3& b_from_a) {
  return {c_from_b.scale * b_from_a.scale,
          (c_from_b.rotation * b_from_a.rotation).normalized(),
          c_from_b * b_from_a.translation};
}

Rigid3 TransformCameraFromWorld(const Similarity3& target_from_source,
                                const Rigid3& camera_from_source) {
  // p_camera' = s p_camera = s (R p_source + t) with
  // p_source = R_s^T (p_target - t_s) / s.
  const Eigen::Quaterniond rotation =
      (camera_from_source.rotation * target_from_source.rotation.conjugate())
          .normalized();
  return {rotation,
          target_from_source.scale * camera_from_source.translation -
              rotation * target_from_source.translation};
}

absl::StatusOr<Similarity3> EstimateSimilarity(
    std::span<const Eigen::Vector3d> p_source,
    std::span<const Eigen::Vector3d> p_target) {
  if (p_source.size() != p_target.size() || p_source.size() < 3) {
    return absl::InvalidArgumentError(
        absl::StrCat("a similarity needs at least 3 pairs of points, got ",
                     p_source.size(),
                     " and ",
                     p_target.size()));
  }
  const auto count = static_cast<Eigen::Index>(p_source.size());
  Eigen::Matrix3Xd source(3, count);
  Eigen::Matrix3Xd target(3, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    source.col(i) = p_source[static_cast<std::size_t>(i)];
    target.col(i) = p_target[static_cast<std::size_t>(i)];
  }
  if (!source.allFinite() || !target.allFinite()) {
    return absl::InvalidArgumentError(
        "a point for the similarity is not finite");
  }
  if (AreCollinear(source) || AreCollinear(target)) {
    return absl::FailedPreconditionError(
        "the points for the similarity lie on one line");
  }
  const Eigen::Matrix4d matrix = Eigen::umeyama(source, target, true);
  const Eigen::Matrix3d scaled_rotation = matrix.topLeftCorner<3, 3>();
  Similarity3 result;
  result.scale = std::cbrt(scaled_rotation.determinant());
  result.translation = matrix.topRightCorner<3, 1>();
  if (!(result.scale > 0.0) || !std::isfinite(result.scale)) {
    return absl::FailedPreconditionError(
        "no similarity relates the points: its scale vanishes");
  }
  result.rotation =
      Eigen::Quaterniond(Eigen::Matrix3d(scaled_rotation / result.scale))
          .normalized();
  return result;
}

}  // namespace groundlock::geometry
