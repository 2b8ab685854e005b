// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/world_solution.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/camera_position_fit.h"
#include "map_store/map/internal/map_point.h"

namespace groundlock::map::internal {
namespace {

using geometry::GeodeticPosition;
using geometry::Similarity3;

// Pairs of points that tell where the new world is.
struct Pairs {
  std::vector<std::string> names;
  std::vector<Eigen::Vector3d> p_world;     // present
  std::vector<Eigen::Vector3d> p_measured;  // new world, or at `base`
  std::optional<GeodeticPosition> base;     // of geodetic places
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

WorldSolution FromPairs(const Pairs& pairs,
                        const Similarity3& similarity,
                        const AlignmentRequest& request) {
  WorldSolution solution;
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
  Aligner(const AlignmentRequest& request,
          const MapData& data,
          AlignmentReport& report)
      : request_(request), data_(data), report_(report) {}

  absl::StatusOr<WorldSolution> Solve() {
    return std::visit([this](const auto& method) { return Solve(method); },
                      request_.method);
  }

 private:
  absl::StatusOr<WorldSolution> Solve(std::monostate /*none*/) {
    WorldSolution solution;
    solution.metric = data_.metric;
    solution.origin = data_.origin;
    solution.fixed = false;
    if (request_.origin) {
      return Invalid("origin: needs a similarity or places");
    }
    return solution;
  }

  absl::StatusOr<WorldSolution> Solve(const SimilarityFromSource& method) {
    WorldSolution solution;
    ASSIGN_OR_RETURN(const Similarity3 similarity,
                     CheckedSimilarity(method.new_world_from_source));
    solution.new_world_from_world =
        similarity * data_.world_from_source.Inverse();
    solution.origin = request_.origin;
    return solution;
  }

  absl::StatusOr<WorldSolution> Solve(const SimilarityFromWorld& method) {
    WorldSolution solution;
    ASSIGN_OR_RETURN(solution.new_world_from_world,
                     CheckedSimilarity(method.new_world_from_world));
    solution.origin = request_.origin;
    return solution;
  }

  absl::StatusOr<WorldSolution> Solve(const KnownDistance& method) {
    if (!(method.distance_m > 0.0) || !std::isfinite(method.distance_m)) {
      return Invalid("distance_m: must be positive");
    }
    if (request_.origin) {
      return Invalid("origin: needs a similarity or places");
    }
    ASSIGN_OR_RETURN(
        const Eigen::Vector3d from,
        LocateMapPoint(data_, method.from, "from", report_.warnings));
    ASSIGN_OR_RETURN(const Eigen::Vector3d to,
                     LocateMapPoint(data_, method.to, "to", report_.warnings));
    const double length = (to - from).norm();
    WorldSolution solution;
    solution.new_world_from_world.scale = method.distance_m / length;
    if (!std::isfinite(solution.new_world_from_world.scale) ||
        !(solution.new_world_from_world.scale > 0.0)) {
      return absl::FailedPreconditionError("the two points are one");
    }
    solution.origin = data_.origin;
    solution.fixed = false;
    return solution;
  }

  absl::StatusOr<WorldSolution> Solve(const ControlPoints& method) {
    Pairs pairs;
    std::vector<Place> places;
    for (const ControlPoint& control : method.points) {
      ASSIGN_OR_RETURN(
          pairs.p_world.emplace_back(),
          LocateMapPoint(data_, control.point, control.name, report_.warnings));
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

  absl::StatusOr<WorldSolution> Solve(const CameraPositions& method) {
    if (!(method.accuracy_m > 0.0) || !std::isfinite(method.accuracy_m)) {
      return Invalid("accuracy_m: must be positive");
    }
    Pairs pairs;
    std::vector<Place> places;
    std::size_t num_unknown = 0;
    for (const CameraPosition& position : method.positions) {
      const auto view = FindView(data_, position.image);
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
    auto fit = FitCameraPositions(
        pairs.p_world, pairs.p_measured, method.accuracy_m, request_.seed);
    if (!fit.ok()) return base::Annotate(fit.status(), "camera positions");
    report_.warnings.insert(
        report_.warnings.end(), fit->warnings.begin(), fit->warnings.end());
    AddResiduals(pairs, fit->measured_from_world, fit->used, report_);
    return FromPairs(pairs, fit->measured_from_world, request_);
  }

  const AlignmentRequest& request_;
  const MapData& data_;
  AlignmentReport& report_;
};

}  // namespace

absl::StatusOr<WorldSolution> SolveWorld(const AlignmentRequest& request,
                                         const MapData& data,
                                         AlignmentReport& report) {
  return Aligner(request, data, report).Solve();
}

}  // namespace groundlock::map::internal
