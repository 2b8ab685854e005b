// SPDX-License-Identifier: Apache-2.0
// Ground that is not a plane: heights over the ground plane on a grid.
#ifndef GROUNDLOCK_MAP_STORE_MAP_GROUND_RELIEF_H_
#define GROUNDLOCK_MAP_STORE_MAP_GROUND_RELIEF_H_

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "map_store/geometry/plane.h"

namespace groundlock::map {

struct MapData;

// A biquadratic B-spline over a regular grid in the axes of the ground plane
// (geometry::PlaneAxes): heights and slopes are continuous. Lengths in metres
// (map units if the map is not metric). Const methods are thread-safe.
struct GroundRelief {
  // Files and memory are bounded by it.
  static constexpr std::size_t kMaxKnots = 250'000;
  // A spline's piece needs three coefficients each way.
  static constexpr std::size_t kMinSide = 3;

  struct Knot {
    float coefficient = 0.0F;
    // 1 sigma of the height there; infinite where nobody knows.
    float sigma = 0.0F;
  };

  bool empty() const { return knots.empty(); }
  std::size_t rows() const { return columns == 0 ? 0 : knots.size() / columns; }

  struct Height {
    double height = 0.0;  // over the plane, along its normal
    Eigen::Vector2d slope = Eigen::Vector2d::Zero();  // d height / d place
    double sigma = 0.0;
  };
  // nullopt outside the grid and where nobody knows.
  std::optional<Height> At(const Eigen::Vector2d& p_plane) const;

  // From the lowest to the highest place that is known.
  double Range() const;

  // Numbers finite, sizes that belong together. kInvalidArgument.
  absl::Status Validate() const;

  // The middle of knot (0, 0); knots lie `step` apart, columns along the first
  // axis.
  Eigen::Vector2d origin_plane = Eigen::Vector2d::Zero();
  double step = 1.0;
  std::size_t columns = 0;
  std::vector<Knot> knots;  // row by row
};

// What the landmarks tell of the ground's relief; empty if the plane explains
// them as well, nothing is known of the ground, or there are too few.
//
// A penalised spline (Eilers & Marx 1996) through the landmarks that are low:
// by robust weights that forgive what lies below the surface more than what
// stands on it, from a stiff surface and wide tolerances to a supple one and
// narrow ones (Kraus & Pfeifer 1998). How supple it may be, or whether it is
// the plane, is the choice with the greatest evidence (MacKay 1992).
// `data` must be valid and in a world. Deterministic.
GroundRelief EstimateGroundRelief(const MapData& data);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_GROUND_RELIEF_H_
