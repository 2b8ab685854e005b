// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/alignment.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/camera_position_fit.h"
#include "map_store/map/internal/ground.h"
#include "map_store/map/internal/map_point.h"
#include "map_store/map/internal/up_evidence.h"

namespace groundlock::map {
namespace {

using geometry::GeodeticPosition;
using geometry::Plane;
using geometry::Similarity3;

// Pairs of points that tell where the new world is.
struct Pairs {
  std::vector<std::string> names;
  std::vector<Eigen::Vector3d> p_world;     // present
  std::vector<Eigen::Vector3d> p_measured;  // new world, or at `base`
  std::optional<GeodeticPosition> base;     // of geodetic places
};

// The new world, and whether its place is fixed by what was given.
struct Solution {
  Similarity3 new_world_from_world;
  std::optional<GeodeticPosition> origin;
  bool metric = true;
  bool fixed = true;         // the ground may not move it
  bool origin_free = false;  // its height is ours to choose
};

absl::Status Invalid(const std::string& what) {
  return absl::InvalidArgumentError(what);
}

absl::StatusOr<Similarity3> CheckedSimilarity(const Similarity3& similarity) {
  if (!similarity.IsFinite() || !(similarity.scale > 0.0) ||
      !(similarity.rotation.norm() > 1e-3)) {
    return Invalid(
        "the similarity needs a positive scale, a rotation and finite numbers");
  }
  Similarity3 unit = similarity;
  unit.rotation.normalize();
  return unit;
}

// Adds places as points of one frame: the new world's, or that at their middle.
absl::Status AddPlaces(const std::vector<Place>& places,
                       const std::optional<GeodeticPosition>& origin,
                       Pairs& pairs) {
  std::vector<GeodeticPosition> geodetic;
  for (const Place& place : places) {
    if (const auto* on_earth = std::get_if<GeodeticPosition>(&place)) {
      RETURN_IF_ERROR(on_earth->Validate());
      geodetic.push_back(*on_earth);
    } else if (!std::get<Eigen::Vector3d>(place).allFinite()) {
      return Invalid("a position is not finite");
    }
  }
  if (!geodetic.empty() && geodetic.size() != places.size()) {
    return Invalid("places are of one kind: all on Earth, or none");
  }
  if (geodetic.empty()) {
    for (const Place& place : places) {
      pairs.p_measured.push_back(std::get<Eigen::Vector3d>(place));
    }
    return absl::OkStatus();
  }
  pairs.base = origin ? *origin : geometry::MiddleOf(geodetic);
  for (const GeodeticPosition& place : geodetic) {
    pairs.p_measured.push_back(geometry::WorldFromGeodetic(*pairs.base, place));
    // Further apart, places have nothing to do with one map.
    if (pairs.p_measured.back().norm() > 100'000.0) {
      return Invalid("the places are more than 100 km apart");
    }
  }
  return absl::OkStatus();
}

void AddResiduals(const Pairs& pairs,
                  const Similarity3& similarity,
                  const std::vector<bool>& used,
                  AlignmentReport& report) {
  for (std::size_t i = 0; i < pairs.names.size(); ++i) {
    report.residuals.push_back(
        {pairs.names[i],
         similarity * pairs.p_world[i] - pairs.p_measured[i],
         used.empty() || used[i]});
  }
}

Solution FromPairs(const Pairs& pairs,
                   const Similarity3& similarity,
                   const AlignmentRequest& request) {
  Solution solution;
  solution.new_world_from_world = similarity;
  solution.origin = pairs.base ? pairs.base : request.origin;
  solution.origin_free = pairs.base.has_value() && !request.origin;
  return solution;
}

// A point whose absence changes its own error from small to large has a
// wrong coordinate; least squares spreads that over all.
void WarnOfOutlyingPoint(const Pairs& pairs, AlignmentReport& report) {
  constexpr std::size_t kMinPoints = 5;
  if (pairs.names.size() < kMinPoints) return;
  std::vector<double> errors;
  for (std::size_t left_out = 0; left_out < pairs.names.size(); ++left_out) {
    std::vector<Eigen::Vector3d> source = pairs.p_world;
    std::vector<Eigen::Vector3d> target = pairs.p_measured;
    source.erase(source.begin() + static_cast<std::ptrdiff_t>(left_out));
    target.erase(target.begin() + static_cast<std::ptrdiff_t>(left_out));
    double others = 0.0;
    const auto fitted = geometry::EstimateSimilarity(source, target);
    if (!fitted.ok()) continue;
    for (std::size_t i = 0; i < source.size(); ++i) {
      others = std::max(others, (*fitted * source[i] - target[i]).norm());
    }
    const double own =
        (*fitted * pairs.p_world[left_out] - pairs.p_measured[left_out]).norm();
    if (own > 5.0 * others && own > 0.01) {
      report.warnings.push_back(absl::StrFormat(
          "%s is %.3f m away from where the other points put it, which agree "
          "to %.3f m: check its coordinates",
          pairs.names[left_out],
          own,
          others));
    }
  }
}

class Aligner {
 public:
  Aligner(const AlignmentRequest& request, const MapData& data)
      : request_(request), data_(data) {}

  absl::StatusOr<Solution> Solve() {
    return std::visit([this](const auto& method) { return Solve(method); },
                      request_.method);
  }
  AlignmentReport& report() { return report_; }

 private:
  absl::StatusOr<Solution> Solve(std::monostate /*none*/) {
    Solution solution;
    solution.metric = data_.metric;
    solution.origin = data_.origin;
    solution.fixed = false;
    if (request_.origin) {
      return Invalid("origin: needs a similarity or places");
    }
    return solution;
  }

  absl::StatusOr<Solution> Solve(const SimilarityFromSource& method) {
    Solution solution;
    ASSIGN_OR_RETURN(const Similarity3 similarity,
                     CheckedSimilarity(method.new_world_from_source));
    solution.new_world_from_world =
        similarity * data_.world_from_source.Inverse();
    solution.origin = request_.origin;
    return solution;
  }

  absl::StatusOr<Solution> Solve(const SimilarityFromWorld& method) {
    Solution solution;
    ASSIGN_OR_RETURN(solution.new_world_from_world,
                     CheckedSimilarity(method.new_world_from_world));
    solution.origin = request_.origin;
    return solution;
  }

  absl::StatusOr<Solution> Solve(const KnownDistance& method) {
    if (!(method.distance_m > 0.0) || !std::isfinite(method.distance_m)) {
      return Invalid("distance_m: must be positive");
    }
    if (request_.origin) {
      return Invalid("origin: needs a similarity or places");
    }
    ASSIGN_OR_RETURN(
        const Eigen::Vector3d from,
        internal::LocateMapPoint(data_, method.from, "from", report_.warnings));
    ASSIGN_OR_RETURN(
        const Eigen::Vector3d to,
        internal::LocateMapPoint(data_, method.to, "to", report_.warnings));
    const double length = (to - from).norm();
    Solution solution;
    solution.new_world_from_world.scale = method.distance_m / length;
    if (!std::isfinite(solution.new_world_from_world.scale) ||
        !(solution.new_world_from_world.scale > 0.0)) {
      return absl::FailedPreconditionError("the two points are one");
    }
    solution.origin = data_.origin;
    solution.fixed = false;
    return solution;
  }

  absl::StatusOr<Solution> Solve(const ControlPoints& method) {
    Pairs pairs;
    std::vector<Place> places;
    for (const ControlPoint& control : method.points) {
      ASSIGN_OR_RETURN(
          pairs.p_world.emplace_back(),
          internal::LocateMapPoint(
              data_, control.point, control.name, report_.warnings));
      pairs.names.push_back(control.name);
      places.push_back(control.place);
    }
    RETURN_IF_ERROR(AddPlaces(places, request_.origin, pairs));
    ASSIGN_OR_RETURN(
        const Similarity3 similarity,
        geometry::EstimateSimilarity(pairs.p_world, pairs.p_measured));
    AddResiduals(pairs, similarity, {}, report_);
    WarnOfOutlyingPoint(pairs, report_);
    return FromPairs(pairs, similarity, request_);
  }

  absl::StatusOr<Solution> Solve(const CameraPositions& method) {
    if (!(method.accuracy_m > 0.0) || !std::isfinite(method.accuracy_m)) {
      return Invalid("accuracy_m: must be positive");
    }
    Pairs pairs;
    std::vector<Place> places;
    std::size_t num_unknown = 0;
    for (const CameraPosition& position : method.positions) {
      const auto view = internal::FindView(data_, position.image);
      if (!view.ok()) {
        ++num_unknown;
        continue;
      }
      pairs.names.push_back(position.image);
      pairs.p_world.push_back(
          data_.views[*view].camera_from_world.Inverse().translation);
      places.push_back(position.place);
    }
    if (num_unknown > 0) {
      report_.warnings.push_back(absl::StrCat(num_unknown,
                                              " of ",
                                              method.positions.size(),
                                              " positions are of images that "
                                              "are not in the map"));
    }
    if (places.size() < 3) {
      return absl::FailedPreconditionError(absl::StrCat(
          "it takes the positions of 3 images of the map, there are ",
          places.size()));
    }
    RETURN_IF_ERROR(AddPlaces(places, request_.origin, pairs));
    auto fit = internal::FitCameraPositions(
        pairs.p_world, pairs.p_measured, method.accuracy_m, request_.seed);
    if (!fit.ok()) return base::Annotate(fit.status(), "camera positions");
    report_.warnings.insert(
        report_.warnings.end(), fit->warnings.begin(), fit->warnings.end());
    AddResiduals(pairs, fit->measured_from_world, fit->used, report_);
    return FromPairs(pairs, fit->measured_from_world, request_);
  }

  const AlignmentRequest& request_;
  const MapData& data_;
  AlignmentReport report_;
};

// A ground in the present world, and how sure it is.
struct ChosenGround {
  std::optional<Plane> plane;  // unset = as it is
  GroundState state = GroundState::kMeasured;
  double sigma_rad = 0.0;
  double height_sigma = 0.0;  // MapData::ground_height_sigma
  std::string doubt;
};

// The ground that was asked for.
absl::StatusOr<ChosenGround> ChooseGround(const AlignmentRequest& request,
                                          const Solution& solution,
                                          const MapData& data) {
  if (const auto* given = std::get_if<GroundPlane>(&request.ground)) {
    const double norm = given->plane_world.normal.norm();
    if (!(norm > 1e-6) || !std::isfinite(norm) ||
        !std::isfinite(given->plane_world.d)) {
      return Invalid("ground_plane: its normal vanishes");
    }
    ChosenGround chosen;
    chosen.plane =
        Plane{given->plane_world.normal / norm, given->plane_world.d / norm};
    return chosen;
  }
  if (const auto* seed = std::get_if<GroundSeed>(&request.ground)) {
    if (!seed->p_world.allFinite()) return Invalid("ground_seed: not finite");
    auto plane = internal::FitGroundAround(data, seed->p_world, request.seed);
    if (!plane.ok()) return base::Annotate(plane.status(), "ground_seed");
    ChosenGround chosen;
    chosen.plane = *plane;
    return chosen;
  }
  const bool automatic =
      std::holds_alternative<GroundAutomatic>(request.ground) ||
      !std::holds_alternative<KnownDistance>(request.method);
  if (!automatic) {
    return ChosenGround{
        std::nullopt,
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
                   internal::EstimateGround(data, request.seed, up));
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

// Half a metre is what good terrains and good receivers differ by; more is
// said.
constexpr double kTerrainApart_m = 0.5;

// Nor is ground known better than grass is high.
constexpr double kLeastTerrainSigma_m = 0.02;

// What of the terrain holds in this map: its height, and how good it is.
struct PlacedTerrain {
  double offset_m = 0.0;  // to be added to its heights
  double sigma_m = 0.0;
  double middle_m = 0.0;  // height below the middle of the cameras, z
};

absl::StatusOr<PlacedTerrain> PlaceTerrain(const AlignmentRequest& request,
                                           const GivenTerrain& terrain,
                                           const MapData& data,
                                           AlignmentReport& report) {
  RETURN_IF_ERROR(terrain.Validate());
  if (request.method.index() != 0) {
    return Invalid(
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
                     Solution& solution) {
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

// Up as the cameras are held; the world's origin stays in their middle.
void LevelByCameras(MapData& data) {
  data.in_world = true;
  data.metric = false;
  data.ground_state = GroundState::kUnknown;
  data.ground_sigma_rad = 0.0;
  data.ground_height_sigma = 0.0;
  if (data.views.empty()) return;
  std::vector<geometry::Rigid3> poses;
  for (const MapViewData& view : data.views) {
    poses.push_back(view.camera_from_world);
  }
  const Eigen::Vector3d up = internal::UpEvidence(poses).Best();
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
  Aligner aligner(request, data);
  ASSIGN_OR_RETURN(Solution solution, aligner.Solve());
  AlignmentReport& report = aligner.report();
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
  return std::move(report);
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
    return Invalid("origin: needs an alignment");
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
