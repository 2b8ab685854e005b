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

// A camera standing in the world over a ground plane. All functions below are
// pure and thread-safe. Lengths are metres (map units if the map is not metric).
struct GroundView {
  const geometry::CameraModel* camera = nullptr;
  geometry::Rigid3 world_from_camera;
  geometry::Plane ground_world;  // normal up, the camera on its positive side
};

// Where the ray through a pixel meets the ground; nullopt above the horizon,
// outside the lens model or farther than kMaxRange_m.
std::optional<Eigen::Vector3d> GroundFromImage(const GroundView& view,
                                               const Eigen::Vector2d& pixel_px);

// §3.6.2, eq. 3.18-3.24: the 2D box's lower corners on the ground span the
// front face, its upper corners give the height, the footprint is square.
// The heading of the result is the front face's inward normal.
// kOutOfRange if a lower corner is not on the ground in front of the camera.
absl::StatusOr<geometry::Box3> LiftBox(const GroundView& view,
                                       const geometry::Box2& box_px);

// §3.6.2, eq. 3.25-3.28: the axis-aligned 2D box of a 3D box, from its lower
// right and upper left front corners along the camera's directions on the
// ground. nullopt if a corner is not in front of the camera.
std::optional<geometry::Box2> ProjectBoxFront(const GroundView& view,
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
