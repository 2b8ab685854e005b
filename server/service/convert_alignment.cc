// SPDX-License-Identifier: Apache-2.0
// AlignMap's request and response.
#include "map_store/base/status.h"
#include "server/service/convert.h"

namespace groundlock::service {
namespace {

// Far more than images of any map that was ever made.
constexpr int kMaxPlaces = 100'000;

absl::StatusOr<Eigen::Vector3d> Vector(const pb::Vector3& v,
                                       const std::string& field) {
  const Eigen::Vector3d vector(v.x(), v.y(), v.z());
  if (!vector.allFinite()) {
    return absl::InvalidArgumentError(field +
                                      ": holds a number that is not finite");
  }
  return vector;
}

absl::StatusOr<map::MapPoint> Point(const pb::AlignMapRequest::MapPoint& point,
                                    const std::string& field) {
  map::MapPoint result;
  if (point.has_position_world() == (point.pixels_size() > 0)) {
    return absl::InvalidArgumentError(
        field + ": needs either position_world or pixels");
  }
  if (point.has_position_world()) {
    ASSIGN_OR_RETURN(result.p_world,
                     Vector(point.position_world(), field + ".position_world"));
  }
  for (const auto& pixel : point.pixels()) {
    result.pixels.push_back({pixel.image(), {pixel.x_px(), pixel.y_px()}});
  }
  return result;
}

absl::StatusOr<map::Place> MakePlace(const pb::AlignMapRequest::Place& place,
                                     const std::string& field) {
  if (place.has_geodetic()) {
    ASSIGN_OR_RETURN(const geometry::GeodeticPosition geodetic,
                     FromProto(place.geodetic(), field + ".geodetic"));
    return map::Place(geodetic);
  }
  if (!place.has_position_m()) {
    return absl::InvalidArgumentError(field + ": is not set");
  }
  ASSIGN_OR_RETURN(const Eigen::Vector3d position,
                   Vector(place.position_m(), field + ".position_m"));
  return map::Place(position);
}

absl::Status CheckCount(int count, const std::string& field) {
  if (count <= kMaxPlaces) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, ": more than ", kMaxPlaces));
}

absl::Status TakeMethod(const pb::AlignMapRequest& request,
                        map::AlignmentRequest* out) {
  switch (request.method_case()) {
    case pb::AlignMapRequest::kNewWorldFromSource: {
      ASSIGN_OR_RETURN(
          const geometry::Similarity3 similarity,
          FromProto(request.new_world_from_source(), "new_world_from_source"));
      out->method = map::SimilarityFromSource{similarity};
      return absl::OkStatus();
    }
    case pb::AlignMapRequest::kNewWorldFromWorld: {
      ASSIGN_OR_RETURN(
          const geometry::Similarity3 similarity,
          FromProto(request.new_world_from_world(), "new_world_from_world"));
      out->method = map::SimilarityFromWorld{similarity};
      return absl::OkStatus();
    }
    case pb::AlignMapRequest::kKnownDistance: {
      const auto& given = request.known_distance();
      map::KnownDistance distance;
      ASSIGN_OR_RETURN(distance.from,
                       Point(given.from(), "known_distance.from"));
      ASSIGN_OR_RETURN(distance.to, Point(given.to(), "known_distance.to"));
      distance.distance_m = given.distance_m();
      out->method = std::move(distance);
      return absl::OkStatus();
    }
    case pb::AlignMapRequest::kControlPoints: {
      const auto& given = request.control_points().points();
      RETURN_IF_ERROR(CheckCount(given.size(), "control_points.points"));
      map::ControlPoints points;
      for (int i = 0; i < given.size(); ++i) {
        const std::string field =
            absl::StrCat("control_points.points[", i, "]");
        map::ControlPoint& point = points.points.emplace_back();
        point.name = given[i].name().empty() ? absl::StrCat("point ", i)
                                             : given[i].name();
        ASSIGN_OR_RETURN(point.point,
                         Point(given[i].point(), field + ".point"));
        ASSIGN_OR_RETURN(point.place,
                         MakePlace(given[i].place(), field + ".place"));
      }
      out->method = std::move(points);
      return absl::OkStatus();
    }
    case pb::AlignMapRequest::kCameraPositions: {
      const auto& given = request.camera_positions();
      RETURN_IF_ERROR(
          CheckCount(given.positions_size(), "camera_positions.positions"));
      map::CameraPositions positions;
      if (given.accuracy_m() != 0.0) positions.accuracy_m = given.accuracy_m();
      for (int i = 0; i < given.positions_size(); ++i) {
        map::CameraPosition& position = positions.positions.emplace_back();
        position.image = given.positions(i).image();
        ASSIGN_OR_RETURN(
            position.place,
            MakePlace(
                given.positions(i).place(),
                absl::StrCat("camera_positions.positions[", i, "].place")));
      }
      out->method = std::move(positions);
      return absl::OkStatus();
    }
    case pb::AlignMapRequest::METHOD_NOT_SET:
      break;
  }
  return absl::OkStatus();
}

absl::StatusOr<map::GivenTerrain> Terrain(
    const pb::AlignMapRequest::Terrain& terrain) {
  map::GivenTerrain result;
  result.first = {terrain.first_x_m(), terrain.first_y_m()};
  result.step = terrain.step_m();
  result.columns = terrain.columns();
  result.z.assign(terrain.z_m().begin(), terrain.z_m().end());
  result.sigma = terrain.sigma_m();
  result.fit_height = terrain.fit_height();
  RETURN_IF_ERROR(base::Annotate(result.Validate(), "ground_terrain"));
  return result;
}

}  // namespace

absl::StatusOr<map::AlignmentRequest> FromProto(
    const pb::AlignMapRequest& request) {
  map::AlignmentRequest result;
  result.seed = request.seed();
  RETURN_IF_ERROR(TakeMethod(request, &result));
  if (request.has_origin()) {
    ASSIGN_OR_RETURN(result.origin, FromProto(request.origin(), "origin"));
  }
  if (request.has_ground_seed_world()) {
    ASSIGN_OR_RETURN(const Eigen::Vector3d seed,
                     Vector(request.ground_seed_world(), "ground_seed_world"));
    result.ground = map::GroundSeed{seed};
  } else if (request.has_ground_plane_world()) {
    const pb::Plane& plane = request.ground_plane_world();
    ASSIGN_OR_RETURN(const Eigen::Vector3d normal,
                     Vector(plane.normal(), "ground_plane_world.normal"));
    result.ground = map::GroundPlane{{normal, plane.d()}};
  } else if (request.has_ground_terrain()) {
    ASSIGN_OR_RETURN(result.ground, Terrain(request.ground_terrain()));
  } else if (request.ground_automatic()) {
    result.ground = map::GroundAutomatic{};
  }
  return result;
}

void ToProto(const map::AlignmentReport& report, pb::AlignMapResponse* out) {
  ToProto(report.new_world_from_world, out->mutable_new_world_from_world());
  for (const map::AlignmentReport::Residual& residual : report.residuals) {
    pb::AlignMapResponse::Residual* target = out->add_residuals();
    target->set_name(residual.name);
    target->mutable_error_m()->set_x(residual.error_m.x());
    target->mutable_error_m()->set_y(residual.error_m.y());
    target->mutable_error_m()->set_z(residual.error_m.z());
    target->set_used(residual.used);
  }
  out->set_rms_error_m(report.rms_error_m);
  out->set_rms_horizontal_error_m(report.rms_horizontal_error_m);
  out->set_median_error_m(report.median_error_m);
  out->set_max_error_m(report.max_error_m);
  if (report.terrain) {
    pb::AlignMapResponse::TerrainAgreement* terrain = out->mutable_terrain();
    terrain->set_offset_m(report.terrain->offset);
    terrain->set_scatter_m(report.terrain->scatter);
    terrain->set_num_ground(report.terrain->num_ground);
    terrain->set_num_landmarks(report.terrain->num_landmarks);
  }
  out->mutable_warnings()->Assign(report.warnings.begin(),
                                  report.warnings.end());
}

}  // namespace groundlock::service
