// SPDX-License-Identifier: Apache-2.0
// Between boxes in the image and boxes on the ground (Robinson 2014, §3.6).
#ifndef GROUNDLOCK_SERVER_GROUND_GROUND_MODEL_H_
#define GROUNDLOCK_SERVER_GROUND_GROUND_MODEL_H_

#include <Eigen/Core>
#include <optional>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::ground {

// Rays that meet the ground farther away than this count as above the horizon:
// an absolute bound, and one that holds for maps without scale (300 camera
// heights are 0.19 degrees under the horizon, where a pixel spans metres).
inline constexpr double kMaxRange_m = 10'000.0;
inline constexpr double kMaxRangeOverHeight = 300.0;

// A camera standing in the world over a ground plane. All functions below are
// pure and thread-safe. Lengths are metres (map units if the map is not
// metric).
struct GroundView {
  const geometry::CameraModel* camera = nullptr;
  geometry::Rigid3 world_from_camera;
  geometry::Plane ground_world;  // normal up, the camera on its positive side
};

// Height of the camera's centre over the ground; not positive if it is below.
double CameraHeight_m(const GroundView& view);

// Unit direction on the ground that the camera looks in: its forward axis
// projected on the ground or, for a camera that looks straight down, the
// direction that is up in the image.
Eigen::Vector3d ForwardOnGround(const GroundView& view);

// An upright box that stands on the ground at p_ground_world.
//   heading_world  direction of its length; its part along the ground counts.
geometry::Box3 UprightBox(const geometry::Plane& ground_world,
                          const Eigen::Vector3d& p_ground_world,
                          const Eigen::Vector3d& heading_world,
                          const Eigen::Vector3d& size_m);

// Unit direction of the ray through a pixel; nullopt outside the lens model.
std::optional<Eigen::Vector3d> RayWorld(const GroundView& view,
                                        const Eigen::Vector2d& pixel_px);

// Where the ray through a pixel meets the ground; nullopt above the horizon,
// outside the lens model, farther than kMaxRange_m, or if the camera is below
// the ground.
std::optional<Eigen::Vector3d> GroundFromImage(const GroundView& view,
                                               const Eigen::Vector2d& pixel_px);

// §3.6.2, eq. 3.18-3.24: the 2D box's lower corners on the ground span the
// front face, its upper corners give the height, the footprint is square.
// The heading of the result is the front face's inward normal.
// kOutOfRange if a lower corner is not on the ground in front of the camera, or
// an upper one not above it on the front face's plane (a target seen from above
// has no front face in view: see box_fit.h). kInvalidArgument: no size.
absl::StatusOr<geometry::Box3> LiftBox(const GroundView& view,
                                       const geometry::Box2& box_px);

// §3.6.2, eq. 3.25-3.28: the axis-aligned 2D box of a 3D box, from its lower
// right and upper left front corners along the camera's directions on the
// ground. nullopt if a corner is not in front of the camera.
std::optional<geometry::Box2> ProjectBoxFront(
    const GroundView& view,
    const Eigen::Vector3d& p_ground_world,
    double width_m,
    double height_m);

// The axis-aligned hull of the eight projected corners. nullopt as above.
std::optional<geometry::Box2> ProjectBoxHull(const GroundView& view,
                                             const geometry::Box3& box);

// §3.6.3: apparent size now over apparent size then, for a target at distance
// distance_now_m that was first seen at distance_then_m (then / now: a receding
// target shrinks).
double ScaleFromDistance(double distance_then_m, double distance_now_m);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_GROUND_MODEL_H_
