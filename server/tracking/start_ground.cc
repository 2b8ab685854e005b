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
// So many times as far away as a crest the ground goes on behind it.
constexpr double kBehind = 1.15;

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
  if (surface.IsPlane()) {
    return {patch ? patch->tangent_world : surface.reference_world(), false};
  }
  const Eigen::Vector3d& eye = camera.view.world_from_camera.translation;
  const Eigen::Vector3d& up = surface.reference_world().normal;
  const Eigen::Vector2d edge_px(
      0.0, std::max(kEdge_px, kEdgeOfBox * box_px.height()));
  if (!patch) {
    // A relief is smoother than the ground, and a crest of it lower: what it
    // has behind the first ground below the box tells one from its end.
    for (double below_px = edge_px.y(); below_px < box_px.height();
         below_px += edge_px.y()) {
      const auto near =
          SeenGround(camera, surface, foot_px + Eigen::Vector2d(0.0, below_px));
      if (!near) continue;
      if (!surface.At(eye + kBehind * (*near - eye))) break;
      const auto ray = ground::RayWorld(camera.view, foot_px);
      if (!ray) break;
      // On the crest, which is as high as the feet are seen there.
      const Eigen::Vector3d p_foot_world =
          eye + (*near - eye).norm() * ray->normalized();
      const auto rise_m = surface.HeightOf(p_foot_world);
      if (!rise_m) break;
      return {{up, -up.dot(p_foot_world)}, true, *rise_m};
    }
    return {surface.reference_world(), false};
  }
  const auto near = SeenGround(camera, surface, foot_px + edge_px);
  const auto far = SeenGround(camera, surface, foot_px - edge_px);
  if (near &&
      (!far || (*far - eye).norm() > kSameGround * (*near - eye).norm())) {
    return {{up, -up.dot(*near)}, true};
  }
  return {patch->tangent_world, false};
}

}  // namespace groundlock::tracking
