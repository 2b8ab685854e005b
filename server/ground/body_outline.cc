// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_outline.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

namespace groundlock::ground {
namespace {

using geometry::Box2;
using geometry::Box3;
using geometry::Matrix6d;
using geometry::Rigid3;

using Params = Eigen::Matrix<double, 6, 1>;
using Edges = Eigen::Vector4d;

constexpr int kIterations = 6;
constexpr double kStep = 1e-5;
// What is off by so many sigmas counts half.
constexpr double kRobust = 2.0;

StandingBody Moved(const StandingBody& body, const Params& x) {
  StandingBody moved = body;
  moved.world_from_body =
      body.world_from_body * Rigid3{Eigen::Quaterniond(Eigen::AngleAxisd(
                                        x[2], Eigen::Vector3d::UnitZ())),
                                    {x[0], x[1], 0.0}};
  moved.size_m = body.size_m.cwiseProduct(x.tail<3>().array().exp().matrix());
  return moved;
}

}  // namespace

std::optional<StandingBody> FitToOutline(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const StandingBody& before,
    const SeenOutline& seen,
    OutlinePart part,
    double times) {
  const GroundView view{&camera, world_from_camera, {}};
  const double sigma_px = times * seen.sigma_px;
  // In sigmas.
  const auto errors = [&](const Params& x) -> std::optional<Edges> {
    const StandingBody body = Moved(before, x);
    Box3 box;
    box.size_m = body.size_m;
    box.world_from_object = body.world_from_body;
    box.world_from_object.translation =
        body.world_from_body * Eigen::Vector3d(0.0, 0.0, 0.5 * body.size_m.z());
    const auto hull = ProjectBodyHull(view, box, body.shape);
    if (!hull) return std::nullopt;
    if (part == OutlinePart::kEdges) {
      return Edges(seen.OffBy_px(*hull) / sigma_px);
    }
    Edges sizes = Edges::Zero();
    sizes.head<2>() =
        seen.SizeOffBy_px(*hull) / (std::numbers::sqrt2 * sigma_px);
    return sizes;
  };
  const Matrix6d information =
      before.covariance.ldlt().solve(Matrix6d::Identity());
  Params x = Params::Zero();
  Matrix6d normal = information;
  for (int i = 0; i < kIterations; ++i) {
    const auto at = errors(x);
    if (!at) return std::nullopt;
    Eigen::Matrix<double, 4, 6> J;
    for (int k = 0; k < 6; ++k) {
      const auto moved = errors(x + kStep * Params::Unit(k));
      if (!moved) return std::nullopt;
      J.col(k) = (*moved - *at) / kStep;
    }
    const Edges weights =
        (1.0 + at->array().square() / (kRobust * kRobust)).inverse();
    normal = information + J.transpose() * weights.asDiagonal() * J;
    const Params step = normal.ldlt().solve(
        -(information * x + J.transpose() * weights.cwiseProduct(*at)));
    if (!step.allFinite()) return std::nullopt;
    x += step;
  }
  StandingBody after = Moved(before, x);
  const auto off = errors(x);
  if (!off) return std::nullopt;
  after.surprise = x.dot(information * x) + off->squaredNorm();
  after.covariance = normal.ldlt().solve(Matrix6d::Identity());
  return after;
}

}  // namespace groundlock::ground
