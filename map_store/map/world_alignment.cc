// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/ground_scene.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {
namespace {

using geometry::Plane;
using internal::GroundScene;

// Landmarks that may belong to the ground before it is known: as high as a
// ground tilted by the limit rises over 10 m.
constexpr double kBand_m = 0.5;
constexpr double kMaxTilt_rad = 3.0 * std::numbers::pi / 180.0;
constexpr double kMaxOffset_m = 0.25;
// The fitted plane must hold this many times what z = 0 holds, within a quarter
// of the tolerance (2.5 mm per metre of distance) or less: an alignment that
// was surveyed is not to be replaced by one that is merely as good. How finely
// landmarks lie depends on the map: a road seen along it shows 4 cm only within
// a millimetre per metre.
constexpr double kMinGain = 1.2;
constexpr std::array<double, 3> kFineTolerances = {0.25, 0.12, 0.06};
// Nor by chance: so many sigmas of the difference of two counts.
constexpr double kMinSigmas = 4.0;
constexpr std::size_t kMinPoints = 30;

// The scene's points that lie within the finest share of the tolerance that
// tells the plane from z = 0; empty if none does.
std::vector<std::size_t> ClearlyOn(const GroundScene& scene,
                                   const Plane& plane) {
  for (const double tolerances : kFineTolerances) {
    std::vector<std::size_t> on =
        internal::PointsWithin(scene, plane, tolerances);
    const auto here = static_cast<double>(on.size());
    const auto at_zero = static_cast<double>(
        internal::PointsWithin(scene, Plane(), tolerances).size());
    if (on.size() >= kMinPoints && here >= kMinGain * at_zero &&
        here - at_zero >= kMinSigmas * std::sqrt(here + at_zero)) {
      return on;
    }
  }
  return {};
}

}  // namespace

Plane FitGroundNearZero(const MapData& data) {
  const Plane zero;
  const GroundScene scene = internal::MakeGroundScene(data, 0);
  std::vector<Eigen::Vector3d> band;
  for (const Eigen::Vector3d& point : scene.points) {
    if (std::abs(point.z()) < kBand_m) band.push_back(point);
  }
  if (band.size() < kMinPoints) return zero;
  const auto start = geometry::FitPlaneRansac(band, {});
  if (!start.ok()) return zero;
  Plane plane = start->plane;
  // What stands on the ground would lift it: the band narrows to where the
  // landmarks are densest.
  for (const double width : {1.0, 1.0, 0.7, 0.5, 0.35, 0.25}) {
    const auto refined = geometry::FitPlane(
        internal::Select(scene, internal::PointsWithin(scene, plane, width)));
    if (!refined.ok()) return zero;
    plane = *refined;
  }
  if (plane.normal.z() < 0.0) plane = plane.Flipped();
  if (std::acos(std::min(plane.normal.z(), 1.0)) >= kMaxTilt_rad) return zero;

  const std::vector<std::size_t> inliers = ClearlyOn(scene, plane);
  if (inliers.empty()) return zero;
  double mean_height_m = 0.0;
  for (const std::size_t i : inliers) mean_height_m += scene.points[i].z();
  mean_height_m /= static_cast<double>(inliers.size());
  return std::abs(mean_height_m) < kMaxOffset_m ? plane : zero;
}

absl::Status AlignToWorld(const geometry::Similarity3& world_from_source,
                          MapData& data) {
  if (!world_from_source.IsFinite() || !(world_from_source.scale > 0.0) ||
      !(world_from_source.rotation.norm() > 1e-3)) {
    return absl::InvalidArgumentError(
        "the alignment is not a similarity: scale must be positive, rotation "
        "not zero, all numbers finite");
  }
  geometry::Similarity3 unit = world_from_source;
  unit.rotation.normalize();
  // `data` may have been moved already.
  data.Transform(unit * data.world_from_source.Inverse());
  data.world_from_source = unit;
  data.metric = true;
  data.origin.reset();
  data.in_world = true;
  data.ground = FitGroundNearZero(data);
  data.ground_state = GroundState::kMeasured;
  data.ground_sigma_rad = 0.0;
  data.ground_height_sigma = 0.0;
  return absl::OkStatus();
}

}  // namespace groundlock::map
