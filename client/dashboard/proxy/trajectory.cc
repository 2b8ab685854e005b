// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/trajectory.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/geometry/geodesy.h"

namespace groundlock::dashboard {
namespace {

constexpr std::string_view kCsvHeader =
    "frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,"
    "inliers,target,target_state,confidence,box_x,box_y,box_w,box_h,ground_x,"
    "ground_y,ground_z,heading_rad,length_m,width_m,height_m,decode_ms,"
    "localize_ms,track_ms,total_ms\n";

using Results = std::vector<std::shared_ptr<const gl::FrameResult>>;

double Seconds(const gl::FrameResult& result) {
  return 1e-9 * static_cast<double>(result.capture_time_ns());
}

std::string_view NameOf(gl::CameraState state) {
  switch (state) {
    case gl::CAMERA_STATE_INITIALIZING:
      return "INITIALIZING";
    case gl::CAMERA_STATE_TRACKED:
      return "TRACKED";
    case gl::CAMERA_STATE_HELD:
      return "HELD";
    case gl::CAMERA_STATE_ODOMETRY:
      return "ODOMETRY";
    default:
      return "LOST";
  }
}

std::string_view NameOf(gl::TargetState state) {
  switch (state) {
    case gl::TARGET_STATE_TRACKED:
      return "TRACKED";
    case gl::TARGET_STATE_PREDICTED:
      return "PREDICTED";
    default:
      return "LOST";
  }
}

void AppendCsvCamera(const gl::CameraResult& camera, std::string* out) {
  absl::StrAppend(out, base::Abseil(NameOf(camera.state())), ",");
  if (camera.has_world_from_camera()) {
    const gl::Vector3& p = camera.world_from_camera().translation();
    const gl::Quaternion& q = camera.world_from_camera().rotation();
    absl::StrAppendFormat(out,
                          "%.6f,%.6f,%.6f,%.9f,%.9f,%.9f,%.9f,",
                          p.x(),
                          p.y(),
                          p.z(),
                          q.w(),
                          q.x(),
                          q.y(),
                          q.z());
  } else {
    out->append(",,,,,,,");
  }
  absl::StrAppend(out, std::max(0, camera.num_inliers()), ",");
}

void AppendCsvTarget(const gl::TargetResult& target, std::string* out) {
  // Ids are of [A-Za-z0-9._-]: nothing to quote.
  absl::StrAppendFormat(out,
                        "%s,%s,%.4f,",
                        target.target_id(),
                        base::Abseil(NameOf(target.state())),
                        target.confidence());
  if (target.has_box()) {
    absl::StrAppendFormat(out,
                          "%.3f,%.3f,%.3f,%.3f,",
                          target.box().x(),
                          target.box().y(),
                          target.box().width(),
                          target.box().height());
  } else {
    out->append(",,,,");
  }
  if (target.has_ground_center_m()) {
    absl::StrAppendFormat(out,
                          "%.6f,%.6f,%.6f,%.6f,",
                          target.ground_center_m().x(),
                          target.ground_center_m().y(),
                          target.ground_center_m().z(),
                          target.heading_rad());
  } else {
    out->append(",,,,");
  }
  if (target.has_box_world()) {
    const gl::Vector3& size = target.box_world().size_m();
    absl::StrAppendFormat(out, "%.4f,%.4f,%.4f,", size.x(), size.y(), size.z());
  } else {
    out->append(",,,");
  }
}

std::string Csv(const Results& results) {
  std::string out(kCsvHeader);
  for (const auto& result : results) {
    const int rows = std::max(1, result->targets_size());
    for (int i = 0; i < rows; ++i) {
      absl::StrAppendFormat(
          &out, "%d,%.6f,", result->sequence(), Seconds(*result));
      AppendCsvCamera(result->camera(), &out);
      if (i < result->targets_size()) {
        AppendCsvTarget(result->targets(i), &out);
      } else {
        out.append(14, ',');
      }
      const gl::StageTimes& times = result->times();
      absl::StrAppendFormat(&out,
                            "%.3f,%.3f,%.3f,%.3f\n",
                            times.decode_ms(),
                            times.localize_ms(),
                            times.track_ms(),
                            times.total_ms());
    }
  }
  return out;
}

bool HasPose(const gl::FrameResult& result) {
  return result.camera().has_world_from_camera();
}

const gl::TargetResult* FindTarget(const gl::FrameResult& result,
                                   std::string_view id) {
  for (const gl::TargetResult& target : result.targets()) {
    if (target.target_id() == id && target.has_ground_center_m()) {
      return &target;
    }
  }
  return nullptr;
}

absl::StatusOr<std::string> Tum(const Results& results, std::string_view of) {
  std::string out;
  const bool camera = of.empty() || of == "camera";
  const auto append = [&out](const gl::FrameResult& result,
                             const gl::Vector3& p,
                             const gl::Quaternion& q) {
    absl::StrAppendFormat(&out,
                          "%.9f %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n",
                          Seconds(result),
                          p.x(),
                          p.y(),
                          p.z(),
                          q.x(),
                          q.y(),
                          q.z(),
                          q.w());
  };
  for (const auto& result : results) {
    if (camera) {
      if (!HasPose(*result)) continue;
      const gl::RigidTransform& pose = result->camera().world_from_camera();
      append(*result, pose.translation(), pose.rotation());
    } else if (const gl::TargetResult* target = FindTarget(*result, of)) {
      gl::Quaternion heading;
      heading.set_w(std::cos(0.5 * target->heading_rad()));
      heading.set_z(std::sin(0.5 * target->heading_rad()));
      append(*result, target->ground_center_m(), heading);
    }
  }
  if (!camera && out.empty()) {
    return absl::NotFoundError(
        absl::StrCat("of: no target \"", base::Abseil(of), "\" on the ground"));
  }
  return out;
}

// "longitude,latitude,height" of each point, by what moves.
using Lines = std::map<std::string, std::vector<geometry::GeodeticPosition>>;

Lines GeodeticLines(const Results& results,
                    const gl::GeodeticPosition& origin_proto) {
  const geometry::GeodeticPosition origin{origin_proto.latitude_deg(),
                                          origin_proto.longitude_deg(),
                                          origin_proto.height_m()};
  Lines lines;
  const auto add = [&](const std::string& name, const gl::Vector3& p) {
    lines[name].push_back(
        geometry::GeodeticFromWorld(origin, {p.x(), p.y(), p.z()}));
  };
  for (const auto& result : results) {
    if (HasPose(*result)) {
      add("camera", result->camera().world_from_camera().translation());
    }
    for (const gl::TargetResult& target : result->targets()) {
      if (target.has_ground_center_m()) {
        add(absl::StrCat("target ", target.target_id()),
            target.ground_center_m());
      }
    }
  }
  return lines;
}

std::string Kml(const Lines& lines) {
  std::string out =
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
      "<kml xmlns=\"http://www.opengis.net/kml/2.2\"><Document>\n";
  for (const auto& [name, points] : lines) {
    absl::StrAppend(&out,
                    "<Placemark><name>",
                    name,
                    "</name><LineString><altitudeMode>absolute</altitudeMode>"
                    "<coordinates>\n");
    for (const geometry::GeodeticPosition& point : points) {
      absl::StrAppendFormat(&out,
                            "%.9f,%.9f,%.3f\n",
                            point.longitude_deg,
                            point.latitude_deg,
                            point.height_m);
    }
    out += "</coordinates></LineString></Placemark>\n";
  }
  return out + "</Document></kml>\n";
}

std::string GeoJson(const Lines& lines) {
  std::string out = "{\"type\":\"FeatureCollection\",\"features\":[";
  std::string_view between = "";
  for (const auto& [name, points] : lines) {
    // A line has two points at least.
    if (points.size() < 2) continue;
    absl::StrAppend(&out,
                    base::Abseil(between),
                    "\n{\"type\":\"Feature\",\"properties\":{\"name\":\"",
                    name,
                    "\"},\"geometry\":{\"type\":\"LineString\","
                    "\"coordinates\":[");
    between = ",";
    std::string_view comma = "";
    for (const geometry::GeodeticPosition& point : points) {
      absl::StrAppendFormat(&out,
                            "%s[%.9f,%.9f,%.3f]",
                            base::Abseil(comma),
                            point.longitude_deg,
                            point.latitude_deg,
                            point.height_m);
      comma = ",";
    }
    out += "]}}";
  }
  return out + "\n]}\n";
}

}  // namespace

absl::StatusOr<TrajectoryFormat> TrajectoryFormatFromName(
    std::string_view name) {
  if (name == "csv") return TrajectoryFormat::kCsv;
  if (name == "tum") return TrajectoryFormat::kTum;
  if (name == "kml") return TrajectoryFormat::kKml;
  if (name == "geojson") return TrajectoryFormat::kGeoJson;
  return absl::InvalidArgumentError(absl::StrCat(
      "format: \"", base::Abseil(name), "\" is not csv, tum, kml or geojson"));
}

std::string_view MimeType(TrajectoryFormat format) {
  switch (format) {
    case TrajectoryFormat::kCsv:
      return "text/csv; charset=utf-8";
    case TrajectoryFormat::kTum:
      return "text/plain; charset=utf-8";
    case TrajectoryFormat::kKml:
      return "application/vnd.google-earth.kml+xml";
    case TrajectoryFormat::kGeoJson:
      return "application/geo+json";
  }
  return "application/octet-stream";
}

std::string_view Extension(TrajectoryFormat format) {
  switch (format) {
    case TrajectoryFormat::kCsv:
      return ".csv";
    case TrajectoryFormat::kTum:
      return ".txt";
    case TrajectoryFormat::kKml:
      return ".kml";
    case TrajectoryFormat::kGeoJson:
      return ".geojson";
  }
  return "";
}

absl::StatusOr<std::string> WriteTrajectory(
    const Results& results,
    TrajectoryFormat format,
    std::string_view of,
    const std::optional<gl::GeodeticPosition>& origin) {
  if (format == TrajectoryFormat::kCsv) return Csv(results);
  if (format == TrajectoryFormat::kTum) return Tum(results, of);
  if (!origin.has_value()) {
    return absl::FailedPreconditionError(
        "the map is not georeferenced: align it with places on Earth first");
  }
  const Lines lines = GeodeticLines(results, *origin);
  return format == TrajectoryFormat::kKml ? Kml(lines) : GeoJson(lines);
}

}  // namespace groundlock::dashboard
