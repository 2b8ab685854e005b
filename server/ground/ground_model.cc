// SPDX-License-Identifier: Apache-2.0
#include "server/ground/ground_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

namespace groundlock::ground {
namespace {

using geometry::Box2;
using geometry::Box3;
using geometry::Plane;
using geometry::Rigid3;

// Below this sine between the camera's forward axis and the ground's normal
// (6 degrees) the forward axis says too little about a direction on the ground.
constexpr double kMinForwardOnGround = 0.1;

Eigen::Vector3d OnPlane(const Plane& plane, const Eigen::Vector3d& v) {
  return v - plane.normal.dot(v) * plane.normal;
}

}  // namespace

std::optional<Eigen::Vector3d> RayWorld(const GroundView& view,
                                        const Eigen::Vector2d& pixel_px) {
  const std::optional<Eigen::Vector3d> ray_camera =
      view.camera->RayFromImage(pixel_px);
  if (!ray_camera) return std::nullopt;
  return view.world_from_camera.rotation * *ray_camera;
}

double CameraHeight_m(const GroundView& view) {
  return view.ground_world.SignedDistance(view.world_from_camera.translation);
}

Eigen::Vector3d ForwardOnGround(const GroundView& view) {
  const Eigen::Quaterniond& rotation = view.world_from_camera.rotation;
  const Eigen::Vector3d forward =
      OnPlane(view.ground_world, rotation * Eigen::Vector3d::UnitZ());
  if (forward.norm() > kMinForwardOnGround) return forward.normalized();
  // The forward axis is vertical here, so image up lies along the ground.
  return OnPlane(view.ground_world, rotation * -Eigen::Vector3d::UnitY())
      .normalized();
}

Box3 UprightBox(const Plane& ground_world,
                const Eigen::Vector3d& p_ground_world,
                const Eigen::Vector3d& heading_world,
                const Eigen::Vector3d& size_m) {
  const Eigen::Vector3d& up = ground_world.normal;
  Eigen::Vector3d x = OnPlane(ground_world, heading_world);
  // Any direction does for a heading that has none.
  x = x.norm() > 1e-12 ? x.normalized().eval() : up.unitOrthogonal();
  Eigen::Matrix3d rotation;
  rotation << x, up.cross(x), up;
  return {Rigid3{Eigen::Quaterniond(rotation).normalized(),
                 p_ground_world + 0.5 * size_m.z() * up},
          size_m};
}

std::optional<Eigen::Vector3d> GroundFromImage(
    const GroundView& view, const Eigen::Vector2d& pixel_px) {
  const double height = CameraHeight_m(view);
  if (!(height > 0.0)) return std::nullopt;
  const std::optional<Eigen::Vector3d> ray = RayWorld(view, pixel_px);
  if (!ray) return std::nullopt;
  const Eigen::Vector3d& center = view.world_from_camera.translation;
  const std::optional<Eigen::Vector3d> p =
      geometry::IntersectRay(view.ground_world, center, *ray);
  if (!p) return std::nullopt;
  const double max_range = std::min(kMaxRange_m, kMaxRangeOverHeight * height);
  if (!((*p - center).norm() <= max_range)) return std::nullopt;
  return p;
}

absl::StatusOr<Box3> LiftBox(const GroundView& view, const Box2& box_px) {
  if (!box_px.IsFinite() || !(box_px.Area() > 0.0)) {
    return absl::InvalidArgumentError("the box has no size");
  }
  const Plane& ground = view.ground_world;
  const Eigen::Vector2d bottom_left(box_px.min_px.x(), box_px.max_px.y());
  const auto f1 = GroundFromImage(view, bottom_left);
  const auto f2 = GroundFromImage(view, box_px.max_px);
  if (!f1 || !f2) {
    return absl::OutOfRangeError(
        "the box's lower corners do not lie on the ground in front of the "
        "camera");
  }
  const double width = (*f2 - *f1).norm();
  const Eigen::Vector3d right = (*f2 - *f1) / width;
  // Towards the camera: the thesis' sign of (F2 - F1) x n, checked.
  Eigen::Vector3d outward = right.cross(ground.normal).normalized();
  const Eigen::Vector3d& center = view.world_from_camera.translation;
  if (outward.dot(center - *f1) < 0.0) outward = -outward;
  const Plane front{outward, -outward.dot(*f1)};
  double height = 0.0;
  for (const Eigen::Vector2d& top :
       {box_px.min_px, Eigen::Vector2d(box_px.max_px.x(), box_px.min_px.y())}) {
    const auto ray = RayWorld(view, top);
    const auto p = ray ? geometry::IntersectRay(front, center, *ray)
                       : std::optional<Eigen::Vector3d>();
    if (!p || !(ground.SignedDistance(*p) > 0.0)) {
      return absl::OutOfRangeError(
          "the box's upper corners do not lie on its front face");
    }
    // Both corners are equal without roll; their mean halves a small roll.
    height += 0.5 * ground.SignedDistance(*p);
  }
  const Eigen::Vector3d p_ground =
      ground.Project(0.5 * (*f1 + *f2) - 0.5 * width * outward);
  return UprightBox(ground, p_ground, -outward, {width, width, height});
}

std::optional<Box2> ProjectBoxFront(const GroundView& view,
                                    const Eigen::Vector3d& p_ground_world,
                                    double width_m,
                                    double height_m) {
  const Eigen::Vector3d& up = view.ground_world.normal;
  const Eigen::Vector3d forward = ForwardOnGround(view);
  const Eigen::Vector3d right = forward.cross(up);
  const Eigen::Vector3d front_center =
      view.ground_world.Project(p_ground_world) - 0.5 * width_m * forward;
  const Rigid3 camera_from_world = view.world_from_camera.Inverse();
  const auto top_left = view.camera->ImageFromCamera(
      camera_from_world *
      (front_center - 0.5 * width_m * right + height_m * up));
  const auto bottom_right = view.camera->ImageFromCamera(
      camera_from_world * (front_center + 0.5 * width_m * right));
  if (!top_left || !bottom_right) return std::nullopt;
  // A rolled camera may swap the corners' order.
  return Box2{top_left->cwiseMin(*bottom_right),
              top_left->cwiseMax(*bottom_right)};
}

std::optional<Box2> ProjectBoxHull(const GroundView& view, const Box3& box) {
  const Rigid3 camera_from_world = view.world_from_camera.Inverse();
  std::optional<Box2> hull;
  for (const Eigen::Vector3d& corner : box.CornersWorld()) {
    const auto pixel = view.camera->ImageFromCamera(camera_from_world * corner);
    if (!pixel) return std::nullopt;
    if (!hull) {
      hull = Box2{*pixel, *pixel};
    } else {
      hull->min_px = hull->min_px.cwiseMin(*pixel);
      hull->max_px = hull->max_px.cwiseMax(*pixel);
    }
  }
  return hull;
}

double ScaleFromDistance(double distance_then_m, double distance_now_m) {
  return distance_then_m / distance_now_m;
}

}  // namespace groundlock::ground
