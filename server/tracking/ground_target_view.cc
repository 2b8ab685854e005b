// SPDX-License-Identifier: Apache-2.0
// From which side a target on the ground is seen, and how it is turned there.
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using geometry::Rigid3;

// Of the target's side, over which its axes are seen in the image.
constexpr double kAxisStep = 0.1;
// As the view of the target turns by this, what is followed goes 63 % of the
// way to the outline's middle; smaller turns than the other may be errors.
constexpr double kFollowView_rad = 30.0 * std::numbers::pi / 180.0;
constexpr double kLeastTurn_rad = 3.0 * std::numbers::pi / 180.0;

}  // namespace

Eigen::Matrix3d GroundTarget::TurningAxes() const {
  return (box().world_from_object.rotation *
          Eigen::AngleAxisd(-unturned_rad_, Eigen::Vector3d::UnitZ()))
      .toRotationMatrix();
}

Eigen::Vector3d GroundTarget::ToEye(const CameraView& camera) const {
  return TurningAxes().transpose() *
         (camera.view.world_from_camera.translation -
          OnGround(motion_->state().position_m))
             .normalized();
}

double GroundTarget::ViewAngle_rad(const CameraView& camera) const {
  const geometry::Rigid3& pose = camera.view.world_from_camera;
  const Eigen::Vector3d ray =
      (OnGround(motion_->state().position_m) - pose.translation).normalized();
  const Eigen::Vector3d up = pose.rotation * -Eigen::Vector3d::UnitY();
  const Eigen::Vector2d away = axes_.axes_world.transpose() * (ray + up);
  return WrapAngle_rad(std::atan2(away.y(), away.x()) - heading_rad_ +
                       unturned_rad_);
}

void GroundTarget::FollowView(const CameraView& camera, bool learns) {
  followed_point_.Follow(ToEye(camera), time_);
  const double view_rad = ViewAngle_rad(camera);
  if (!learns && heading_known_) view_rad_ = view_rad;
  const double turn_rad = std::abs(WrapAngle_rad(view_rad - view_rad_));
  if (center_ != BoxCenter::kTexture || turn_rad < kLeastTurn_rad) return;
  const auto outline = BodyHull(camera, box());
  if (!outline) return;
  view_rad_ = view_rad;
  const double share = 1.0 - std::exp(-turn_rad / kFollowView_rad);
  texture_object_ +=
      share * (ground::PointOnRay(
                   camera.view, box(), outline->center_px(), kTextureDepth) -
               texture_object_);
}

double GroundTarget::LeanInImage_rad(
    const CameraView& camera, const Eigen::Vector3d& upright_world) const {
  // As a camera at the same place sees it that looks right at the target.
  const Rigid3& pose = camera.view.world_from_camera;
  const Eigen::Vector3d& up_world = surface_->reference_world().normal;
  const Eigen::Vector3d ray_world =
      (OnGround(motion_->state().position_m) - pose.translation).normalized();
  const Eigen::Vector3d right_world = ray_world.cross(up_world);
  const Eigen::Vector3d above_world = right_world.cross(ray_world);
  const double slope_rad = std::atan2(upright_world.dot(right_world),
                                      upright_world.dot(above_world));
  const Eigen::Vector3d up_camera = pose.rotation.inverse() * up_world;
  return slope_rad + std::atan2(up_camera.x(), -up_camera.y());
}

std::optional<ViewTurn::View> GroundTarget::ViewOf(
    const CameraView& camera) const {
  const Eigen::Vector3d foot_world = OnGround(motion_->state().position_m);
  const Eigen::Matrix3d axes_world = TurningAxes();
  const Rigid3 camera_from_world = camera.view.world_from_camera.Inverse();
  const double step_m = kAxisStep * Side(size_m_);
  const auto seen = [&](const Eigen::Vector3d& way_world) {
    return camera.view.camera->ImageFromCamera(
        camera_from_world * (foot_world + step_m * way_world));
  };
  const auto foot_px = seen(Eigen::Vector3d::Zero());
  if (!foot_px) return std::nullopt;
  ViewTurn::View view;
  for (int k = 0; k < 3; ++k) {
    const auto there_px = seen(axes_world.col(k));
    if (!there_px) return std::nullopt;
    view.px_per_m.col(k) = (*there_px - *foot_px) / step_m;
  }
  view.to_eye = ToEye(camera);
  view.lean_rad = LeanInImage_rad(camera, axes_world.col(2));
  view.width_m = std::sqrt(size_m_.x() * size_m_.y());
  view.height_m = size_m_.z();
  return view;
}

std::optional<PatchTurn> GroundTarget::TurnOf(const CameraView& camera,
                                              double angle_rad) const {
  if (angle_rad == 0.0) return PatchTurn{};
  CameraView turned = camera;
  Rigid3& pose = turned.view.world_from_camera;
  const Eigen::Vector3d ray_world =
      OnGround(motion_->state().position_m) - pose.translation;
  pose.rotation =
      Eigen::AngleAxisd(angle_rad, ray_world.normalized()) * pose.rotation;
  const auto there_px = ProjectForTracker(turned);
  const auto here_px = ProjectForTracker(camera);
  if (!there_px || !here_px) return std::nullopt;
  return PatchTurn{angle_rad,
                   there_px->size_px().cwiseQuotient(here_px->size_px())};
}

}  // namespace groundlock::tracking
