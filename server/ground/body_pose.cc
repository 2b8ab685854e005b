// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_pose.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <vector>

#include "server/ground/internal/view_pose.h"

namespace groundlock::ground {
namespace {

using internal::GroundCovariance;
using internal::Moved;
using internal::Pose;
using internal::PoseJacobian;
using internal::PoseNormal;
using internal::PriorWeights;
using internal::ProjectionError_px;
using internal::RobustWeight;

constexpr int kIterations = 15;

}  // namespace

std::optional<BodyPose> LocateBody(const BodyView& predicted,
                                   std::span<const BodySighting> seen,
                                   double sigma_px) {
  if (seen.size() < 3) return std::nullopt;
  Pose pose = Pose::Zero();
  // Where most are far off at first, those that are not must not decide: the
  // robust scale starts at the median error (graduated non-convexity).
  std::vector<double> errors_px;
  for (const BodySighting& one : seen) {
    const auto error_px =
        ProjectionError_px(predicted, pose, one.p_body, one.pixel_px);
    if (!error_px) return std::nullopt;
    errors_px.push_back(error_px->norm());
  }
  const auto middle =
      errors_px.begin() + static_cast<std::ptrdiff_t>(errors_px.size() / 2);
  std::nth_element(errors_px.begin(), middle, errors_px.end());
  double scale_px = std::max(sigma_px, *middle);
  PoseNormal prior = PoseNormal::Zero();
  prior.diagonal().head<3>() = PriorWeights(predicted);
  prior.bottomRightCorner<3, 3>() = GroundCovariance(predicted).inverse();
  PoseNormal normal;
  for (int i = 0; i < kIterations; ++i) {
    normal = prior;
    Pose gradient = prior * pose;
    for (const BodySighting& one : seen) {
      PoseJacobian A;
      Eigen::Matrix<double, 2, 3> unused;
      const auto error_px = ProjectionError_px(
          predicted, pose, one.p_body, one.pixel_px, &A, &unused);
      if (!error_px) return std::nullopt;
      const double w = RobustWeight(*error_px, scale_px);
      normal += w * A.transpose() * A;
      gradient += w * A.transpose() * *error_px;
    }
    const Pose step = normal.ldlt().solve(-gradient);
    if (!step.allFinite()) return std::nullopt;
    pose += step;
    if (scale_px <= sigma_px && step.norm() < 1e-6) break;
    scale_px = std::max(sigma_px, 0.5 * scale_px);
  }
  BodyPose result;
  result.world_from_body = Moved(predicted.world_from_body, pose);
  const PoseNormal covariance = normal.inverse();
  result.covariance = covariance.topLeftCorner<3, 3>();
  result.ground = pose.tail<3>();
  result.ground_covariance = covariance.bottomRightCorner<3, 3>();
  for (const BodySighting& one : seen) {
    const auto error_px =
        ProjectionError_px(predicted, pose, one.p_body, one.pixel_px);
    if (!error_px) return std::nullopt;
    result.agrees.push_back(error_px->norm() < 3.0 * sigma_px);
    result.agreeing += result.agrees.back() ? 1 : 0;
  }
  return result;
}

}  // namespace groundlock::ground
