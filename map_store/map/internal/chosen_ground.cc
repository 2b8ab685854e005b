// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/chosen_ground.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/ground.h"

namespace groundlock::map::internal {
namespace {

using geometry::Plane;

// Half a metre is what good terrains and good receivers differ by; more is
// said.
constexpr double kTerrainApart_m = 0.5;

// Nor is ground known better than grass is high.
constexpr double kLeastTerrainSigma_m = 0.02;

}  // namespace

absl::StatusOr<ChosenGround> ChooseGround(const AlignmentRequest& request,
                                          const WorldSolution& solution,
                                          const MapData& data) {
  if (const auto* given = std::get_if<GroundPlane>(&request.ground)) {
    const double norm = given->plane_world.normal.norm();
    if (!(norm > 1e-6) || !std::isfinite(norm) ||
        !std::isfinite(given->plane_world.d)) {
      return absl::InvalidArgumentError("ground_plane: its normal vanishes");
    }
    ChosenGround chosen;
    chosen.plane =
        Plane{given->plane_world.normal / norm, given->plane_world.d / norm};
    return chosen;
  }
  if (const auto* seed = std::get_if<GroundSeed>(&request.ground)) {
    if (!seed->p_world.allFinite())
      return absl::InvalidArgumentError("ground_seed: not finite");
    auto plane = FitGroundAround(data, seed->p_world, request.seed);
    if (!plane.ok()) return base::Annotate(plane.status(), "ground_seed");
    ChosenGround chosen;
    chosen.plane = *plane;
    return chosen;
  }
  const bool automatic =
      std::holds_alternative<GroundAutomatic>(request.ground) ||
      !std::holds_alternative<KnownDistance>(request.method);
  if (!automatic) {
    return ChosenGround{std::nullopt,
                        data.ground_state,
                        data.ground_sigma_rad,
                        data.ground_height_sigma,
                        ""};
  }
  // Where the new world's z is known to be up, the ground is nearly level.
  std::optional<Eigen::Vector3d> up;
  if (solution.fixed || solution.origin) {
    up = solution.new_world_from_world.rotation.conjugate() *
         Eigen::Vector3d::UnitZ();
  }
  ASSIGN_OR_RETURN(const GroundEstimate estimate,
                   EstimateGround(data, request.seed, up));
  return ChosenGround{
      estimate.ground_source,
      estimate.doubt.empty() ? GroundState::kEstimated : GroundState::kUnknown,
      estimate.sigma_rad,
      estimate.height_sigma_share(),
      estimate.doubt};
}

Eigen::Vector3d MiddleOfCameras(const MapData& data) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const MapViewData& view : data.views) {
    middle += view.camera_from_world.Inverse().translation;
  }
  return middle /
         static_cast<double>(std::max<std::size_t>(1, data.views.size()));
}

absl::StatusOr<PlacedTerrain> PlaceTerrain(const AlignmentRequest& request,
                                           const GivenTerrain& terrain,
                                           const MapData& data,
                                           AlignmentReport& report) {
  RETURN_IF_ERROR(terrain.Validate());
  if (request.method.index() != 0) {
    return absl::InvalidArgumentError(
        "ground_terrain: is of the map's present world, so give no method with "
        "it");
  }
  if (!data.metric) {
    return absl::FailedPreconditionError(
        "ground_terrain: the map has no metres and no upright yet; align it by "
        "GPS, control points or a similarity first");
  }
  report.terrain = CompareWithLandmarks(terrain, data);
  PlacedTerrain placed;
  placed.sigma_m = terrain.sigma;
  if (report.terrain) {
    if (terrain.fit_height) placed.offset_m = report.terrain->offset;
    if (placed.sigma_m == 0.0) {
      placed.sigma_m = std::max(kLeastTerrainSigma_m, report.terrain->scatter);
    }
  } else if (terrain.fit_height) {
    return absl::FailedPreconditionError(
        "ground_terrain: the map has too few landmarks on its ground to fit "
        "the terrain's height to");
  } else {
    report.warnings.push_back(
        "the map has too few landmarks on its ground to compare the terrain "
        "with");
  }
  const double below = ShareBelow(terrain, placed.offset_m, data);
  if (std::isnan(below)) {
    return absl::FailedPreconditionError(
        "ground_terrain: none of the map's cameras is above a place that the "
        "terrain knows");
  }
  const auto apart = [&] {
    return absl::StrFormat(
        "the map's own ground lies %.2f m %s the terrain (%d of %d landmarks, "
        "%.2f m scatter)",
        std::abs(report.terrain->offset),
        report.terrain->offset > 0.0 ? "above" : "below",
        report.terrain->num_ground,
        report.terrain->num_landmarks,
        report.terrain->scatter);
  };
  constexpr std::string_view kWhy =
      "the terrain's vertical datum is another one, or the map's height is "
      "wrong; fit_height moves the terrain to the map";
  if (below > 0.5) {
    return absl::FailedPreconditionError(
        absl::StrCat("ground_terrain: the cameras would be below the ground",
                     report.terrain ? ": " + apart() : std::string(),
                     ": ",
                     base::Abseil(kWhy)));
  }
  if (!terrain.fit_height && report.terrain &&
      std::abs(report.terrain->offset) >
          std::max(kTerrainApart_m, 3.0 * placed.sigma_m)) {
    report.warnings.push_back(absl::StrCat(apart(), ": ", base::Abseil(kWhy)));
  }
  const Eigen::Vector3d middle = MiddleOfCameras(data);
  const auto known =
      ReliefOf(terrain, 0.0, 0.0).At(Eigen::Vector2d(middle.head<2>()));
  placed.middle_m = (known ? known->height : 0.0) + placed.offset_m;
  return placed;
}

}  // namespace groundlock::map::internal
