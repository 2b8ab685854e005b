// SPDX-License-Identifier: Apache-2.0
// The ground that targets stand on: a plane, or anything that has a height, a
// slope and an uncertainty at a place, and may have holes where nobody knows.
#ifndef GROUNDLOCK_SERVER_GROUND_GROUND_SURFACE_H_
#define GROUNDLOCK_SERVER_GROUND_GROUND_SURFACE_H_

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "map_store/geometry/plane.h"
#include "map_store/map/map.h"

namespace groundlock::ground {

// The ground around a place. Lengths are metres (map units if the map is not
// metric).
struct GroundPatch {
  // Touches the ground there; its normal points up.
  geometry::Plane tangent_world;
  // 1 sigma of the height at the place, along the reference plane's normal;
  // 0 = not stated.
  double height_sigma_m = 0.0;
  // 1 sigma of the tangent's tilt about any axis in it; 0 = not stated.
  double slope_sigma_rad = 0.0;
};

// Immutable; all methods are thread-safe and touch no shared state.
class GroundSurface {
 public:
  virtual ~GroundSurface() = default;

  // The plane that heights are counted from, and whose normal is up: what the
  // surface is nearest to as a whole.
  virtual const geometry::Plane& reference_world() const = 0;

  // Whether it is that plane everywhere.
  virtual bool IsPlane() const = 0;

  // The ground above or below p_world (along the reference's normal), whatever
  // height p_world itself has; nullopt where nothing is known.
  virtual std::optional<GroundPatch> At(
      const Eigen::Vector3d& p_world) const = 0;

  // Where origin + s * direction, 0 < s, first meets the ground from above;
  // nullopt if it does not within max_range_m (> 0, along the ray), starts
  // below the ground, or meets a hole first.
  //   direction_world  any length but zero
  virtual std::optional<Eigen::Vector3d> IntersectRay(
      const Eigen::Vector3d& origin_world,
      const Eigen::Vector3d& direction_world,
      double max_range_m) const = 0;

  // Height of p_world over the ground, along the reference's normal; nullopt
  // over a hole.
  std::optional<double> HeightOf(const Eigen::Vector3d& p_world) const;
};

// The same plane everywhere, without holes.
//   height_sigma_m, slope_sigma_rad  see GroundPatch. The slope is that of the
//     whole plane about `pivot_world`: the height's variance grows with the
//     distance from there.
struct PlaneUncertainty {
  double height_sigma_m = 0.0;
  double slope_sigma_rad = 0.0;
  Eigen::Vector3d pivot_world = Eigen::Vector3d::Zero();
};
std::shared_ptr<const GroundSurface> MakePlaneSurface(
    const geometry::Plane& plane_world,
    const PlaneUncertainty& uncertainty = {});

// Heights over a plane. What is outside the relief, or in one of its holes, is
// a hole; rays pass over one as long as they are above the plane.
std::shared_ptr<const GroundSurface> MakeReliefSurface(
    const geometry::Plane& plane_world, const map::GroundRelief& relief);

// The ground of a map, whatever is known of it.
std::shared_ptr<const GroundSurface> SurfaceOf(const map::Map& map);

}  // namespace groundlock::ground

#endif  // GROUNDLOCK_SERVER_GROUND_GROUND_SURFACE_H_
