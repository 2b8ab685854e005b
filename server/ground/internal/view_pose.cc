// SPDX-License-Identifier: Apache-2.0
#include "server/ground/internal/view_pose.h"

#include <Eigen/Geometry>
#include <cmath>

#include "server/ground/box_fit.h"

namespace groundlock::ground::internal {
namespace {

using geometry::Rigid3;

// What is off by so many sigmas counts half.
constexpr double kRobust = 2.0;

Eigen::Quaterniond TurnOf(const Pose& pose) {
  return Eigen::Quaterniond(
      Eigen::AngleAxisd(pose[2], Eigen::Vector3d::UnitZ()));
}
// A few degrees.
Eigen::Quaterniond TiltOf(const Pose& pose) {
  return Eigen::Quaterniond(1.0, 0.5 * pose[4], 0.5 * pose[5], 0.0)
      .normalized();
}
Eigen::Vector3d PlaceOf(const Pose& pose) {
  return {pose[0], pose[1], pose[3]};
}

}  // namespace

std::optional<Eigen::Vector2d> ProjectionError_px(
    const BodyView& view,
    const Pose& pose,
    const Eigen::Vector3d& p_body,
    const Eigen::Vector2d& pixel_px,
    PoseJacobian* by_pose,
    Eigen::Matrix<double, 2, 3>* by_point) {
  const Eigen::Matrix3d tilt = TiltOf(pose).toRotationMatrix();
  const Eigen::Matrix3d turn = tilt * TurnOf(pose).toRotationMatrix();
  const Eigen::Vector3d p_turned = turn * p_body;
  const Eigen::Vector3d p_start = p_turned + PlaceOf(pose);
  const Rigid3 camera_from_start =
      view.world_from_camera.Inverse() * view.world_from_body;
  Eigen::Matrix<double, 2, 3> J;
  const auto pixel = view.camera.ImageFromCamera(
      camera_from_start * p_start, by_pose != nullptr ? &J : nullptr);
  if (!pixel) return std::nullopt;
  if (by_pose != nullptr) {
    J = J * camera_from_start.rotation.toRotationMatrix();
    by_pose->leftCols<2>() = J.leftCols<2>();
    by_pose->col(2) = J * tilt.col(2).cross(p_turned);
    by_pose->col(3) = J.col(2);
    by_pose->col(4) = J * Eigen::Vector3d::UnitX().cross(p_turned);
    by_pose->col(5) = J * Eigen::Vector3d::UnitY().cross(p_turned);
    *by_point = J * turn;
  }
  return Eigen::Vector2d(*pixel - pixel_px);
}

Rigid3 Moved(const Rigid3& world_from_body, const Pose& pose) {
  return world_from_body * Rigid3{TiltOf(pose) * TurnOf(pose), PlaceOf(pose)};
}

Eigen::Matrix3d GroundCovariance(const BodyView& view) {
  constexpr double kKnown = 1e-6;
  return view.ground_covariance + kKnown * kKnown * Eigen::Matrix3d::Identity();
}

Eigen::Vector3d PriorWeights(const BodyView& view) {
  return Eigen::Vector3d(
             view.place_sigma_m, view.place_sigma_m, view.heading_sigma_rad)
      .cwiseAbs2()
      .cwiseInverse();
}

double RobustCost(double squared) {
  constexpr double kScale = kRobust * kRobust;
  return 0.5 * kScale * std::log1p(squared / kScale);
}

double RobustWeight(double sigmas) {
  return 1.0 / (1.0 + sigmas * sigmas / (kRobust * kRobust));
}

double RobustWeight(const Eigen::Vector2d& error_px, double sigma_px) {
  const double squared = error_px.squaredNorm() / sigma_px / sigma_px;
  return 1.0 / (1.0 + squared / (kRobust * kRobust)) / (sigma_px * sigma_px);
}

OutlineErrors ErrorsOfOutline(const BodyView& view,
                              const Pose& pose,
                              const BodyForm& form) {
  OutlineErrors errors;
  if (!view.outline) return errors;
  const Eigen::Vector3d middle(0.0, 0.0, 0.5 * form.size_m.z());
  geometry::Box3 box;
  box.size_m = form.size_m;
  box.world_from_object = Moved(view.world_from_body, pose);
  box.world_from_object.translation = box.world_from_object * middle;
  const GroundView seen_by{&view.camera, view.world_from_camera, {}};
  const auto hull = ProjectBodyEdges(seen_by, box, form.shape);
  if (!hull) return errors;
  const Eigen::Vector4d off_px = view.outline->OffBy_px(hull->box_px);
  for (int edge = 0; edge < 4; ++edge) {
    if (off_px[edge] == 0.0) continue;
    const int axis = edge % 2;
    const double sigma_px = std::hypot(
        view.outline->sigma_px,
        0.5 * form.size_sigma * view.outline->sure_px.size_px()[axis]);
    PoseJacobian by_pose;
    Eigen::Matrix<double, 2, 3> unused;
    if (!ProjectionError_px(view,
                            pose,
                            hull->edges_object[edge] + middle,
                            Eigen::Vector2d::Zero(),
                            &by_pose,
                            &unused)) {
      continue;
    }
    errors.edges[errors.count++] = {off_px[edge] / sigma_px,
                                    by_pose.row(axis).transpose() / sigma_px};
  }
  return errors;
}

}  // namespace groundlock::ground::internal
