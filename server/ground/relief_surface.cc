// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/ground/ground_surface.h"

namespace groundlock::ground {
namespace {

// Steps of a ray over the grid, in knots along the ground, and halvings of the
// step in which it meets the ground.
constexpr double kStepKnots = 0.5;
constexpr int kHalvings = 20;
// A ray is followed so far, in sides of the grid.
constexpr double kReach = 4.0;

class ReliefSurface final : public GroundSurface {
 public:
  ReliefSurface(const geometry::Plane& plane_world,
                const map::GroundRelief& relief)
      : plane_(plane_world), axes_(plane_world), relief_(relief) {}

  const geometry::Plane& reference_world() const override { return plane_; }
  bool IsPlane() const override { return false; }

  std::optional<GroundPatch> At(const Eigen::Vector3d& p_world) const override {
    const Eigen::Vector2d place = axes_.FromWorld(p_world);
    const auto known = relief_.At(place);
    if (!known) return std::nullopt;
    GroundPatch patch;
    const Eigen::Vector3d normal =
        (plane_.normal - axes_.DirectionToWorld(known->slope)).normalized();
    patch.tangent_world = {
        normal,
        -normal.dot(axes_.ToWorld(place) + known->height * plane_.normal)};
    patch.height_sigma_m = known->sigma;
    patch.slope_sigma_rad = known->sigma / relief_.step;
    return patch;
  }

  std::optional<Eigen::Vector3d> IntersectRay(
      const Eigen::Vector3d& origin_world,
      const Eigen::Vector3d& direction_world,
      double max_range_m) const override {
    const Eigen::Vector3d direction = direction_world.normalized();
    const Eigen::Vector2d along = axes_.axes_world.transpose() * direction;
    const double side = relief_.step * static_cast<double>(std::max(
                                           relief_.columns, relief_.rows()));
    // A ray that goes straight down moves little along the ground.
    const double step_m =
        kStepKnots * relief_.step /
        std::max(along.norm(), kStepKnots * relief_.step / side);
    const double end_m = std::min(
        max_range_m,
        (kReach * side + (axes_.ToWorld(Middle()) - origin_world).norm()));
    double above_m = HeightOver(origin_world);
    if (!(above_m > 0.0)) return std::nullopt;
    for (double at_m = 0.0; at_m < end_m;) {
      const double next_m = std::min(at_m + step_m, end_m);
      const Eigen::Vector3d next = origin_world + next_m * direction;
      if (!(HeightOver(next) > 0.0)) {
        return Meet(origin_world, direction, at_m, next_m);
      }
      at_m = next_m;
    }
    return std::nullopt;
  }

 private:
  Eigen::Vector2d Middle() const {
    return relief_.origin_plane +
           0.5 * relief_.step *
               Eigen::Vector2d(static_cast<double>(relief_.columns),
                               static_cast<double>(relief_.rows()));
  }

  // Over the ground or, over a hole, over the plane.
  double HeightOver(const Eigen::Vector3d& p_world) const {
    const auto known = relief_.At(axes_.FromWorld(p_world));
    return plane_.SignedDistance(p_world) - (known ? known->height : 0.0);
  }

  std::optional<Eigen::Vector3d> Meet(const Eigen::Vector3d& origin_world,
                                      const Eigen::Vector3d& direction,
                                      double above_m,
                                      double below_m) const {
    for (int i = 0; i < kHalvings; ++i) {
      const double middle_m = 0.5 * (above_m + below_m);
      if (HeightOver(origin_world + middle_m * direction) > 0.0) {
        above_m = middle_m;
      } else {
        below_m = middle_m;
      }
    }
    const Eigen::Vector3d p_world = origin_world + below_m * direction;
    if (!relief_.At(axes_.FromWorld(p_world))) return std::nullopt;
    return p_world;
  }

  const geometry::Plane plane_;
  const geometry::PlaneAxes axes_;
  const map::GroundRelief relief_;
};

}  // namespace

std::shared_ptr<const GroundSurface> MakeReliefSurface(
    const geometry::Plane& plane_world, const map::GroundRelief& relief) {
  return std::make_shared<ReliefSurface>(plane_world, relief);
}

}  // namespace groundlock::ground
