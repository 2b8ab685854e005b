// SPDX-License-Identifier: Apache-2.0
// The client's calls that align and check maps.
#include "client/sdk/client.h"
#include "client/sdk/connection.h"
#include "client/sdk/convert.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

void Set(const Eigen::Vector3d& v, pb::Vector3* out) {
  out->set_x(v.x());
  out->set_y(v.y());
  out->set_z(v.z());
}

void Set(const MapPoint& point, pb::AlignMapRequest::MapPoint* out) {
  if (point.position_world) {
    Set(*point.position_world, out->mutable_position_world());
  }
  for (const MapPoint::Pixel& pixel : point.pixels) {
    pb::AlignMapRequest::MapPoint::Pixel* target = out->add_pixels();
    target->set_image(pixel.image);
    target->set_x_px(pixel.xy_px.x());
    target->set_y_px(pixel.xy_px.y());
  }
}

void Set(const Place& place, pb::AlignMapRequest::Place* out) {
  if (const auto* position = std::get_if<Eigen::Vector3d>(&place)) {
    Set(*position, out->mutable_position_m());
  } else {
    ToProto(std::get<geometry::GeodeticPosition>(place),
            out->mutable_geodetic());
  }
}

struct SetMethod {
  pb::AlignMapRequest* out;

  void operator()(std::monostate /*none*/) const {}
  void operator()(const AlignRequest::FromSource& method) const {
    ToProto(method.new_world_from_source, out->mutable_new_world_from_source());
  }
  void operator()(const AlignRequest::FromWorld& method) const {
    ToProto(method.new_world_from_world, out->mutable_new_world_from_world());
  }
  void operator()(const AlignRequest::KnownDistance& method) const {
    Set(method.from, out->mutable_known_distance()->mutable_from());
    Set(method.to, out->mutable_known_distance()->mutable_to());
    out->mutable_known_distance()->set_distance_m(method.distance_m);
  }
  void operator()(const std::vector<AlignRequest::ControlPoint>& points) const {
    out->mutable_control_points();  // set even if there are none
    for (const AlignRequest::ControlPoint& point : points) {
      auto* target = out->mutable_control_points()->add_points();
      target->set_name(point.name);
      Set(point.point, target->mutable_point());
      Set(point.place, target->mutable_place());
    }
  }
  void operator()(const AlignRequest::CameraPositions& method) const {
    auto* target = out->mutable_camera_positions();
    target->set_accuracy_m(method.accuracy_m);
    for (const AlignRequest::CameraPosition& position : method.positions) {
      auto* added = target->add_positions();
      added->set_image(position.image);
      Set(position.place, added->mutable_place());
    }
  }
};

void Set(const AlignRequest::Terrain& terrain,
         pb::AlignMapRequest::Terrain* out) {
  out->set_first_x_m(terrain.first_m.x());
  out->set_first_y_m(terrain.first_m.y());
  out->set_step_m(terrain.step_m);
  out->set_columns(terrain.columns);
  out->mutable_z_m()->Assign(terrain.z_m.begin(), terrain.z_m.end());
  out->set_sigma_m(terrain.sigma_m);
  out->set_fit_height(terrain.fit_height);
}

}  // namespace

absl::StatusOr<AlignReport> Client::AlignMap(const AlignRequest& request) {
  pb::AlignMapRequest message;
  message.set_name(request.name);
  message.set_version(request.version);
  std::visit(SetMethod{&message}, request.method);
  if (request.origin) ToProto(*request.origin, message.mutable_origin());
  if (std::holds_alternative<AlignRequest::AutomaticGround>(request.ground)) {
    message.set_ground_automatic(true);
  } else if (const auto* seed = std::get_if<Eigen::Vector3d>(&request.ground)) {
    Set(*seed, message.mutable_ground_seed_world());
  } else if (const auto* plane =
                 std::get_if<geometry::Plane>(&request.ground)) {
    Set(plane->normal, message.mutable_ground_plane_world()->mutable_normal());
    message.mutable_ground_plane_world()->set_d(plane->d);
  } else if (const auto* terrain =
                 std::get_if<AlignRequest::Terrain>(&request.ground)) {
    Set(*terrain, message.mutable_ground_terrain());
  }
  message.set_seed(request.seed);
  message.set_report_only(request.report_only);
  pb::AlignMapResponse response;
  // Writing a large map takes minutes: no deadline.
  grpc::ClientContext context;
  RETURN_IF_ERROR(
      FromGrpc(connection_->maps->AlignMap(&context, message, &response)));
  AlignReport report;
  report.map = FromProto(response.map());
  const pb::SimilarityTransform& moved = response.new_world_from_world();
  report.new_world_from_world = {moved.scale(),
                                 Eigen::Quaterniond(moved.rotation().w(),
                                                    moved.rotation().x(),
                                                    moved.rotation().y(),
                                                    moved.rotation().z()),
                                 {moved.translation().x(),
                                  moved.translation().y(),
                                  moved.translation().z()}};
  for (const auto& residual : response.residuals()) {
    report.residuals.push_back({residual.name(),
                                {residual.error_m().x(),
                                 residual.error_m().y(),
                                 residual.error_m().z()},
                                residual.used()});
  }
  report.rms_error_m = response.rms_error_m();
  report.rms_horizontal_error_m = response.rms_horizontal_error_m();
  report.median_error_m = response.median_error_m();
  report.max_error_m = response.max_error_m();
  if (response.has_terrain()) {
    report.terrain = {response.terrain().offset_m(),
                      response.terrain().scatter_m(),
                      response.terrain().num_ground(),
                      response.terrain().num_landmarks()};
  }
  report.warnings.assign(response.warnings().begin(),
                         response.warnings().end());
  return report;
}

absl::StatusOr<MapCheck> Client::CheckMap(const std::string& name,
                                          std::uint64_t version) {
  pb::CheckMapRequest request;
  pb::CheckMapResponse response;
  request.set_name(name);
  request.set_version(version);
  // Reading a large map takes a while: no deadline.
  grpc::ClientContext context;
  RETURN_IF_ERROR(
      FromGrpc(connection_->maps->CheckMap(&context, request, &response)));
  MapCheck check{FromProto(response.map()), {}};
  check.problems.assign(response.problems().begin(), response.problems().end());
  return check;
}

}  // namespace groundlock::sdk
