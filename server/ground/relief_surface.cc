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

class ReliefSurface final : public GroundSurface {
 public:
  ReliefSurface(const geometry::Plane& plane_world,
                const map::GroundRelief& relief)
      : plane_(plane_world), axes_(plane_world), relief_(relief) {
    for (const map::GroundRelief::Knot& knot : relief_.knots) {
      const double coefficient = knot.coefficient;
      lowest_m_ = std::min(lowest_m_, coefficient);
      highest_m_ = std::max(highest_m_, coefficient);
    }
  }

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
    if (!(HeightOver(origin_world) > 0.0)) return std::nullopt;
    const Interval within = Within(origin_world, direction, max_range_m);
    const double length_m = within.end_m - within.begin_m;
    if (!(length_m > 0.0) ||
        !(HeightOver(origin_world + within.begin_m * direction) > 0.0)) {
      return std::nullopt;
    }
    // A grid has few knots, so that this is bounded whatever a step is.
    const double along_m =
        length_m * (axes_.axes_world.transpose() * direction).norm();
    const int steps = 1 + static_cast<int>(std::min(
                              along_m / (kStepKnots * relief_.step),
                              (relief_.columns + relief_.rows()) / kStepKnots));
    double above_m = within.begin_m;
    for (int i = 1; i <= steps; ++i) {
      const double at_m = within.begin_m + length_m * i / steps;
      if (!(HeightOver(origin_world + at_m * direction) > 0.0)) {
        return Meet(origin_world, direction, above_m, at_m);
      }
      above_m = at_m;
    }
    return std::nullopt;
  }

 private:
  struct Interval {
    double begin_m = 0.0;
    double end_m = 0.0;

    // Keeps where low <= start + s * slope <= high.
    void Clip(double start, double slope, double low, double high) {
      if (std::abs(slope) < 1e-12) {
        if (!(start >= low && start <= high)) end_m = begin_m;
        return;
      }
      const double a = (low - start) / slope;
      const double b = (high - start) / slope;
      begin_m = std::max(begin_m, std::min(a, b));
      end_m = std::min(end_m, std::max(a, b));
    }
  };

  // Where the ray is over the grid, and no lower or higher than the ground may
  // be there: a spline lies between its coefficients.
  Interval Within(const Eigen::Vector3d& origin_world,
                  const Eigen::Vector3d& direction,
                  double max_range_m) const {
    Interval interval{0.0, max_range_m};
    const Eigen::Vector2d place = axes_.FromWorld(origin_world);
    const Eigen::Vector2d along = axes_.axes_world.transpose() * direction;
    const Eigen::Vector2d size(static_cast<double>(relief_.columns - 1),
                               static_cast<double>(relief_.rows() - 1));
    for (int axis = 0; axis < 2; ++axis) {
      interval.Clip(place(axis),
                    along(axis),
                    relief_.origin_plane(axis),
                    relief_.origin_plane(axis) + relief_.step * size(axis));
    }
    const double margin_m = 1e-6 * (1.0 + highest_m_ - lowest_m_);
    interval.Clip(plane_.SignedDistance(origin_world),
                  direction.dot(plane_.normal),
                  lowest_m_ - margin_m,
                  highest_m_ + margin_m);
    return interval;
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
  // The plane, which stands in for holes, counts.
  double lowest_m_ = 0.0;
  double highest_m_ = 0.0;
};

}  // namespace

std::shared_ptr<const GroundSurface> MakeReliefSurface(
    const geometry::Plane& plane_world, const map::GroundRelief& relief) {
  return std::make_shared<ReliefSurface>(plane_world, relief);
}

}  // namespace groundlock::ground
