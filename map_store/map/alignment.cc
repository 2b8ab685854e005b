// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/alignment.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/chosen_ground.h"
#include "map_store/map/internal/ground.h"
#include "map_store/map/internal/world_solution.h"
#include "map_store/map/measured_up.h"

namespace groundlock::map {
namespace {

using geometry::GeodeticPosition;
using geometry::Plane;
using geometry::Similarity3;
using internal::ChooseGround;
using internal::ChosenGround;
using internal::MiddleOfCameras;
using internal::PlacedTerrain;
using internal::PlaceTerrain;
using internal::WorldSolution;

Plane Transformed(const Similarity3& target_from_source, const Plane& plane) {
  Plane result;
  result.normal = target_from_source.rotation * plane.normal;
  result.d = target_from_source.scale * plane.d -
             result.normal.dot(target_from_source.translation);
  return result;
}

// Moves the solution up or down so that z = 0 is the ground below the middle of
// the cameras.
void PutGroundAtZero(const MapData& data,
                     const Plane& ground_world,
                     WorldSolution& solution) {
  Similarity3& similarity = solution.new_world_from_world;
  const Plane ground = Transformed(similarity, ground_world);
  const Eigen::Vector3d middle = similarity * MiddleOfCameras(data);
  // Straight below: a ground that stands upright has no height.
  if (!(std::abs(ground.normal.z()) > 0.1)) return;
  const double height_m = -(ground.d + ground.normal.x() * middle.x() +
                            ground.normal.y() * middle.y()) /
                          ground.normal.z();
  similarity.translation.z() -= height_m;
  if (!solution.origin) return;
  // Exactly along the origin's own vertical.
  solution.origin->height_m += height_m;
}

void Summarize(AlignmentReport& report) {
  std::vector<double> errors;
  double sum = 0.0;
  double horizontal = 0.0;
  for (const AlignmentReport::Residual& residual : report.residuals) {
    if (!residual.used) continue;
    errors.push_back(residual.error_m.norm());
    sum += residual.error_m.squaredNorm();
    horizontal += residual.error_m.head<2>().squaredNorm();
  }
  if (errors.empty()) return;
  std::sort(errors.begin(), errors.end());
  const auto count = static_cast<double>(errors.size());
  report.rms_error_m = std::sqrt(sum / count);
  report.rms_horizontal_error_m = std::sqrt(horizontal / count);
  report.median_error_m = errors[errors.size() / 2];
  report.max_error_m = errors.back();
}

// Up as the photos' sensors tell it, else as the cameras are held; the world's
// origin stays in their middle.
void LevelByCameras(MapData& data) {
  data.in_world = true;
  data.metric = false;
  data.ground_state = GroundState::kUnknown;
  data.ground_sigma_rad = 0.0;
  data.ground_height_sigma = 0.0;
  if (data.views.empty()) return;
  const Eigen::Vector3d up =
      data.measured_up ? data.measured_up->up_world : UpByCameras(data);
  data.Transform(internal::LevelledFromSource(
      data, Plane{up, -up.dot(MiddleOfCameras(data))}));
  data.ground = Plane{};
}

std::string GroundUnknown(std::string_view why) {
  return absl::StrCat(
      "the ground is unknown: ",
      base::Abseil(why),
      ". Sessions give camera poses and 2D boxes, and no boxes in the world; "
      "groundlock map align tells the ground (a point on it, a plane, control "
      "points)");
}

}  // namespace

absl::StatusOr<AlignmentReport> AlignMap(const AlignmentRequest& request,
                                         MapData& data) {
  if (data.views.empty()) {
    return absl::FailedPreconditionError("the map has no images");
  }
  if (request.origin) {
    RETURN_IF_ERROR(base::Annotate(request.origin->Validate(), "origin"));
  }
  AlignmentReport report;
  ASSIGN_OR_RETURN(WorldSolution solution,
                   internal::SolveWorld(request, data, report));
  const bool by_similarity =
      std::holds_alternative<SimilarityFromSource>(request.method) ||
      std::holds_alternative<SimilarityFromWorld>(request.method);
  std::optional<Plane> ground;
  ChosenGround knowledge;
  // A similarity promises a ground near z = 0, and that is where it is sought.
  const bool near_zero = by_similarity && request.ground.index() == 0;
  const auto* terrain = std::get_if<GivenTerrain>(&request.ground);
  PlacedTerrain placed;
  if (terrain != nullptr) {
    ASSIGN_OR_RETURN(placed, PlaceTerrain(request, *terrain, data, report));
    ground = Plane{Eigen::Vector3d::UnitZ(), -placed.middle_m};
    knowledge.state = GroundState::kMeasured;
  } else if (!near_zero) {
    auto chosen = ChooseGround(request, solution, data);
    if (chosen.ok()) {
      knowledge = *chosen;
      ground = knowledge.plane;
      if (!knowledge.doubt.empty()) {
        report.warnings.push_back(GroundUnknown(knowledge.doubt));
      }
    } else if (request.ground.index() == 0 &&
               (solution.fixed || solution.origin)) {
      knowledge.state = GroundState::kUnknown;
      report.warnings.push_back(
          GroundUnknown(base::Std(chosen.status().message())));
    } else {
      return chosen.status();
    }
  }
  if (!solution.fixed && ground && !solution.origin && terrain == nullptr) {
    const Similarity3 levelled = internal::LevelledFromSource(data, *ground);
    const double scale = solution.new_world_from_world.scale;
    solution.new_world_from_world = levelled;
    solution.new_world_from_world.scale *= scale;
    solution.new_world_from_world.translation *= scale;
  } else if (ground && (solution.origin_free || !solution.fixed)) {
    PutGroundAtZero(data, *ground, solution);
  }
  const bool had_relief = !data.given_relief.empty();
  if (terrain != nullptr) {
    data.ground = *ground;
    data.given_relief =
        ReliefOf(*terrain, placed.middle_m - placed.offset_m, placed.sigma_m);
  } else if (ground || near_zero) {
    data.given_relief = {};
  }
  data.Transform(solution.new_world_from_world);
  if (had_relief && data.given_relief.empty()) {
    report.warnings.push_back(
        "the terrain that was given to the map is of its old world or ground "
        "and no longer holds; give it again");
  }
  data.metric = solution.metric;
  data.origin = solution.metric ? solution.origin : std::nullopt;
  data.in_world = true;
  data.ground_state = knowledge.state;
  data.ground_sigma_rad = knowledge.sigma_rad;
  data.ground_height_sigma = knowledge.height_sigma;
  if (near_zero) {
    data.ground = FitGroundNearZero(data);
  } else if (ground) {
    data.ground = Transformed(solution.new_world_from_world, *ground);
    if (!solution.fixed && !solution.origin && terrain == nullptr) {
      data.ground = Plane{};
    }
  } else if (solution.fixed) {
    data.ground = Plane{};
  }
  report.new_world_from_world = solution.new_world_from_world;
  Summarize(report);
  return report;
}

absl::Status PutIntoWorld(const std::optional<Similarity3>& world_from_source,
                          const std::optional<GeodeticPosition>& origin,
                          std::uint64_t seed,
                          MapData& data,
                          std::vector<std::string>& warnings) {
  AlignmentRequest request;
  request.seed = seed;
  if (world_from_source) {
    request.method = SimilarityFromSource{*world_from_source};
    request.origin = origin;
  } else if (origin) {
    return absl::InvalidArgumentError("origin: needs an alignment");
  } else if (data.in_world) {
    return absl::OkStatus();
  } else if (!data.origin) {
    const auto estimate = AlignToEstimatedGround(seed, data);
    if (estimate.ok()) {
      if (!estimate->doubt.empty()) {
        warnings.push_back(GroundUnknown(estimate->doubt));
      }
      return absl::OkStatus();
    }
    if (!absl::IsFailedPrecondition(estimate.status())) {
      return estimate.status();
    }
    // A map all the same: cameras can be localised in it.
    warnings.push_back(GroundUnknown(base::Std(estimate.status().message())));
    LevelByCameras(data);
    return absl::OkStatus();
  }
  ASSIGN_OR_RETURN(const AlignmentReport report, AlignMap(request, data));
  warnings.insert(
      warnings.end(), report.warnings.begin(), report.warnings.end());
  return absl::OkStatus();
}

}  // namespace groundlock::map
