// SPDX-License-Identifier: Apache-2.0
#include "server/ground/ground_surface.h"

#include <cmath>

namespace groundlock::ground {
namespace {

class PlaneSurface final : public GroundSurface {
 public:
  PlaneSurface(const geometry::Plane& plane_world,
               const PlaneUncertainty& uncertainty)
      : plane_(plane_world), uncertainty_(uncertainty) {}

  const geometry::Plane& reference_world() const override { return plane_; }
  bool IsPlane() const override { return true; }

  std::optional<GroundPatch> At(const Eigen::Vector3d& p_world) const override {
    const double away_m =
        (plane_.Project(p_world) - plane_.Project(uncertainty_.pivot_world))
            .norm();
    return GroundPatch{plane_,
                       std::hypot(uncertainty_.height_sigma_m,
                                  uncertainty_.slope_sigma_rad * away_m),
                       uncertainty_.slope_sigma_rad};
  }

  std::optional<Eigen::Vector3d> IntersectRay(
      const Eigen::Vector3d& origin_world,
      const Eigen::Vector3d& direction_world,
      double max_range_m) const override {
    if (!(plane_.SignedDistance(origin_world) > 0.0)) return std::nullopt;
    const auto p_world =
        geometry::IntersectRay(plane_, origin_world, direction_world);
    if (!p_world || !((*p_world - origin_world).norm() <= max_range_m)) {
      return std::nullopt;
    }
    return p_world;
  }

 private:
  const geometry::Plane plane_;
  const PlaneUncertainty uncertainty_;
};

}  // namespace

std::optional<double> GroundSurface::HeightOf(
    const Eigen::Vector3d& p_world) const {
  const auto patch = At(p_world);
  if (!patch) return std::nullopt;
  const double along =
      patch->tangent_world.normal.dot(reference_world().normal);
  if (!(along > 0.0)) return std::nullopt;
  return patch->tangent_world.SignedDistance(p_world) / along;
}

std::shared_ptr<const GroundSurface> MakePlaneSurface(
    const geometry::Plane& plane_world, const PlaneUncertainty& uncertainty) {
  return std::make_shared<PlaneSurface>(plane_world, uncertainty);
}

std::shared_ptr<const GroundSurface> SurfaceOf(const map::Map& map) {
  const geometry::Plane& plane_world = map.info().ground_world;
  return map.ground_relief().empty()
             ? MakePlaneSurface(plane_world)
             : MakeReliefSurface(plane_world, map.ground_relief());
}

}  // namespace groundlock::ground
