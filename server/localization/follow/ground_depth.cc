// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/ground_depth.h"

#include <algorithm>
#include <cmath>

#include "map_store/geometry/plane.h"

namespace groundlock::localization {
namespace {

// Of the ground's height, over the camera's height above it: kerbs, ruts.
constexpr double kUneven = 0.03;
// Of the angle between the ground and the camera, by the pose's own error and
// by how the ground slopes.
constexpr double kTilt_rad = 0.01;
// Where nobody knows more than that it may slope.
constexpr double kUnknown = 0.5;
constexpr int kSteps = 4;

}  // namespace

std::optional<GroundDepth> DepthOfGround(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const Eigen::Vector2d& pixel_px) {
  const map::MapInfo& info = map.info();
  const auto normalized = camera.NormalizedFromImage(pixel_px);
  if (info.ground_state == map::GroundState::kUnknown || !normalized) {
    return std::nullopt;
  }
  const Eigen::Vector3d& center_world = world_from_camera.translation;
  const Eigen::Vector3d ray_world =
      world_from_camera.rotation * normalized->homogeneous();
  const map::GroundRelief& relief = map.ground_relief();
  geometry::Plane ground = info.ground_world;
  auto p_world = geometry::IntersectRay(ground, center_world, ray_world);
  double height_sigma = 0.0;
  bool is_known = true;
  if (!relief.empty()) {
    const geometry::PlaneAxes axes(info.ground_world);
    for (int step = 0; step < kSteps && p_world && is_known; ++step) {
      const auto there = relief.At(axes.FromWorld(*p_world));
      is_known = there.has_value();
      if (!there) break;
      height_sigma = there->sigma;
      ground.d = info.ground_world.d - there->height;
      p_world = geometry::IntersectRay(ground, center_world, ray_world);
    }
  }
  const double height = ground.SignedDistance(center_world);
  if (!p_world || !(height > 0.0)) return std::nullopt;
  GroundDepth result;
  result.depth = (world_from_camera.Inverse() * *p_world).z();
  result.relative_sigma = kUnknown;
  if (is_known) {
    const double along =
        (*p_world - center_world + height * ground.normal).norm();
    const double by_tilt =
        std::max(kTilt_rad, info.ground_sigma_rad) * along / height;
    const double by_height =
        std::hypot(kUneven, info.ground_height_sigma, height_sigma / height);
    result.relative_sigma = std::min(kUnknown, std::hypot(by_height, by_tilt));
  }
  return result;
}

}  // namespace groundlock::localization
