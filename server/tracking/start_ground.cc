// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/start_ground.h"

#include <algorithm>
#include <optional>

#include "server/ground/ground_model.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// A box's lower edge is good to this.
constexpr double kEdge_px = 2.0;
constexpr double kEdgeOfBox = 0.02;
// An edge whose error changes the distance by more than this factor lies on a
// crest.
constexpr double kSameGround = 1.3;

std::optional<Eigen::Vector3d> SeenGround(const CameraView& camera,
                                          const ground::GroundSurface& surface,
                                          const Eigen::Vector2d& pixel_px) {
  const auto ray = ground::RayWorld(camera.view, pixel_px);
  if (!ray) return std::nullopt;
  return surface.IntersectRay(
      camera.view.world_from_camera.translation, *ray, ground::kMaxRange_m);
}

}  // namespace

StartGround StartGroundOf(const CameraView& camera,
                          const ground::GroundSurface& surface,
                          const Box2& box_px) {
  const Eigen::Vector2d foot_px(box_px.center_px().x(), box_px.max_px.y());
  const auto p_world = SeenGround(camera, surface, foot_px);
  const auto patch = p_world ? surface.At(*p_world) : std::nullopt;
  if (!patch) return {surface.reference_world(), false};
  if (surface.IsPlane()) return {patch->tangent_world, false};
  const Eigen::Vector3d& eye = camera.view.world_from_camera.translation;
  const Eigen::Vector2d edge_px(
      0.0, std::max(kEdge_px, kEdgeOfBox * box_px.height()));
  const auto near = SeenGround(camera, surface, foot_px + edge_px);
  const auto far = SeenGround(camera, surface, foot_px - edge_px);
  if (near &&
      (!far || (*far - eye).norm() > kSameGround * (*near - eye).norm())) {
    const Eigen::Vector3d& up = surface.reference_world().normal;
    return StartGround{{up, -up.dot(*near)}, true};
  }
  return StartGround{patch->tangent_world, false};
}

}  // namespace groundlock::tracking
