// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "map_store/base/status.h"
#include "map_store/formats/internal/brown_lens.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/formats/internal/opensfm_model.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

absl::StatusOr<int> SizePx(const JsonNode& camera, const char* key) {
  ASSIGN_OR_RETURN(const std::int64_t size, camera.Integer(key));
  if (size < 1 || size > CameraModel::kMaxSizePx) {
    return camera.Error(absl::StrCat(key, " ", size, " is out of range"));
  }
  return static_cast<int>(size);
}

absl::StatusOr<double> FirstOf(const JsonNode& camera,
                               const char* key,
                               const char* other) {
  return camera.Number(camera.Has(key) ? key : other);
}

absl::StatusOr<CameraModel> ReadOpenSfmCamera(
    const JsonNode& camera, std::vector<std::string>* warnings) {
  std::string type = "perspective";  // early files do not say
  if (camera.Has("projection_type")) {
    ASSIGN_OR_RETURN(type, camera.String("projection_type"));
  }
  const bool fisheye = type == "fisheye" || type == "fisheye_opencv";
  if (!fisheye && type != "perspective" && type != "simple_radial" &&
      type != "radial" && type != "brown") {
    return absl::UnimplementedError(absl::StrCat(
        camera.Path(),
        ": projection type \"",
        type.substr(0, 80),
        "\" is not supported; known are perspective, simple_radial, radial, "
        "brown, fisheye, fisheye_opencv"));
  }
  ASSIGN_OR_RETURN(const int width_px, SizePx(camera, "width"));
  ASSIGN_OR_RETURN(const int height_px, SizePx(camera, "height"));
  // Lengths are in units of the larger side, from the image's centre.
  const double side_px = std::max(width_px, height_px);
  BrownLens lens;
  ASSIGN_OR_RETURN(const double fx, FirstOf(camera, "focal_x", "focal"));
  ASSIGN_OR_RETURN(const double fy, FirstOf(camera, "focal_y", "focal"));
  ASSIGN_OR_RETURN(const double cx, camera.NumberOr("c_x", 0.0));
  ASSIGN_OR_RETURN(const double cy, camera.NumberOr("c_y", 0.0));
  lens.fx_px = fx * side_px;
  lens.fy_px = fy * side_px;
  lens.principal_point_px = {cx * side_px + 0.5 * width_px,
                             cy * side_px + 0.5 * height_px};
  ASSIGN_OR_RETURN(lens.k[0], camera.NumberOr("k1", 0.0));
  ASSIGN_OR_RETURN(lens.k[1], camera.NumberOr("k2", 0.0));
  ASSIGN_OR_RETURN(lens.k[2], camera.NumberOr("k3", 0.0));
  if (fisheye) {
    ASSIGN_OR_RETURN(const double k4, camera.NumberOr("k4", 0.0));
    auto model = CameraModel::Create(CameraModelId::kOpenCvFisheye,
                                     width_px,
                                     height_px,
                                     std::array{lens.fx_px,
                                                lens.fy_px,
                                                lens.principal_point_px.x(),
                                                lens.principal_point_px.y(),
                                                lens.k[0],
                                                lens.k[1],
                                                lens.k[2],
                                                k4});
    return model.ok() ? model
                      : camera.Error(base::Std(model.status().message()));
  }
  ASSIGN_OR_RETURN(lens.p[0], camera.NumberOr("p1", 0.0));
  ASSIGN_OR_RETURN(lens.p[1], camera.NumberOr("p2", 0.0));
  return CameraFromBrown(lens, width_px, height_px, camera.Path(), warnings);
}

class OpenSfmParser {
 public:
  explicit OpenSfmParser(const JsonNode& reconstruction)
      : reconstruction_(reconstruction) {}

  absl::StatusOr<OpenSfmModel> Run() {
    RETURN_IF_ERROR(ReadCameras());
    RETURN_IF_ERROR(ReadShots());
    RETURN_IF_ERROR(ReadPoints());
    RETURN_IF_ERROR(ReadReference());
    return std::move(model_);
  }

 private:
  absl::Status ReadCameras() {
    ASSIGN_OR_RETURN(const JsonNode cameras, reconstruction_.Field("cameras"));
    RETURN_IF_ERROR(cameras.CheckIsObject());
    for (const auto& [name, value] : cameras.value().items()) {
      const JsonNode camera = cameras.Child(name, value);
      ASSIGN_OR_RETURN(const CameraModel model,
                       ReadOpenSfmCamera(camera, &model_.warnings));
      camera_by_name_[name] = static_cast<std::uint32_t>(model_.cameras.size());
      model_.cameras.push_back(model);
    }
    return absl::OkStatus();
  }

  absl::Status ReadShots() {
    ASSIGN_OR_RETURN(const JsonNode shots, reconstruction_.Field("shots"));
    RETURN_IF_ERROR(shots.CheckIsObject());
    for (const auto& [name, value] : shots.value().items()) {
      const JsonNode node = shots.Child(name, value);
      OpenSfmShot shot;
      shot.image = name;
      if (const absl::Status valid = CheckImageName(name); !valid.ok()) {
        return node.Error(base::Std(valid.message()));
      }
      ASSIGN_OR_RETURN(const std::string camera, node.String("camera"));
      const auto found = camera_by_name_.find(camera);
      if (found == camera_by_name_.end()) {
        return node.Error("its camera is not in the reconstruction");
      }
      shot.camera = found->second;
      ASSIGN_OR_RETURN(const Eigen::Vector3d rotation,
                       node.Vector3("rotation"));
      ASSIGN_OR_RETURN(shot.camera_from_world.translation,
                       node.Vector3("translation"));
      if (!(rotation.norm() < 1e6)) {
        return node.Error("its rotation is out of range");
      }
      shot.camera_from_world.rotation =
          geometry::QuaternionFromRotationVector(rotation).normalized();
      model_.shots.push_back(std::move(shot));
    }
    return absl::OkStatus();
  }

  absl::Status ReadPoints() {
    ASSIGN_OR_RETURN(const JsonNode points, reconstruction_.Field("points"));
    RETURN_IF_ERROR(points.CheckIsObject());
    model_.points.reserve(points.size());
    for (const auto& [track, value] : points.value().items()) {
      const JsonNode node = points.Child(track, value);
      map::MapLandmarkData point;
      ASSIGN_OR_RETURN(point.p_world, node.Vector3("coordinates"));
      if (node.Has("color")) {
        ASSIGN_OR_RETURN(const Eigen::Vector3d color, node.Vector3("color"));
        for (int i = 0; i < 3; ++i) {
          point.rgb.at(static_cast<std::size_t>(i)) =
              static_cast<std::uint8_t>(std::clamp(color(i), 0.0, 255.0));
        }
      }
      model_.point_by_track[track] =
          static_cast<std::uint32_t>(model_.points.size());
      model_.points.push_back(point);
    }
    return absl::OkStatus();
  }

  absl::Status ReadReference() {
    if (!reconstruction_.Has("reference_lla")) return absl::OkStatus();
    ASSIGN_OR_RETURN(const JsonNode node,
                     reconstruction_.Field("reference_lla"));
    geometry::GeodeticPosition reference;
    ASSIGN_OR_RETURN(reference.latitude_deg, node.Number("latitude"));
    ASSIGN_OR_RETURN(reference.longitude_deg, node.Number("longitude"));
    ASSIGN_OR_RETURN(reference.height_m, node.Number("altitude"));
    // Without GPS OpenSfM writes zeros, and lengths mean nothing.
    if (reference.latitude_deg == 0.0 && reference.longitude_deg == 0.0) {
      return absl::OkStatus();
    }
    if (const absl::Status valid = reference.Validate(); !valid.ok()) {
      return node.Error(base::Std(valid.message()));
    }
    model_.reference = reference;
    return absl::OkStatus();
  }

  const JsonNode& reconstruction_;
  OpenSfmModel model_;
  absl::flat_hash_map<std::string, std::uint32_t> camera_by_name_;
};

}  // namespace

absl::StatusOr<OpenSfmModel> ParseOpenSfm(std::string_view text,
                                          std::string_view file) {
  ASSIGN_OR_RETURN(const nlohmann::json json, ParseJson(text, file));
  const JsonNode document(json, file);
  if (!document.is_array() || document.size() == 0) {
    return document.Error("is not OpenSfM's list of reconstructions");
  }
  std::size_t best = 0;
  std::size_t most_shots = 0;
  for (std::size_t i = 0; i < document.size(); ++i) {
    const JsonNode model = document.Element(i);
    ASSIGN_OR_RETURN(const JsonNode shots, model.Field("shots"));
    if (shots.size() > most_shots) {
      best = i;
      most_shots = shots.size();
    }
  }
  const JsonNode chosen = document.Element(best);
  ASSIGN_OR_RETURN(OpenSfmModel model, OpenSfmParser(chosen).Run());
  model.num_models = document.size();
  return model;
}

absl::StatusOr<std::vector<OpenSfmObservation>> ParseOpenSfmTracks(
    std::string_view text, std::string_view file, const OpenSfmModel& model) {
  constexpr std::string_view kHeader = "OPENSFM_TRACKS_VERSION_v";
  absl::flat_hash_map<std::string_view, std::uint32_t> shot_by_image;
  for (std::uint32_t i = 0; i < model.shots.size(); ++i) {
    shot_by_image[model.shots[i].image] = i;
  }
  std::vector<OpenSfmObservation> observations;
  TextReader reader(text, file);
  std::string_view line;
  bool first = true;
  bool has_size = false;  // since version 1
  while (reader.NextLine(&line)) {
    if (Trim(line).empty()) continue;
    if (std::exchange(first, false) && line.starts_with(kHeader)) {
      const std::string_view version = Trim(line.substr(kHeader.size()));
      if (version != "0" && version != "1" && version != "2") {
        return reader.Error("tracks of this version are not supported");
      }
      has_size = version != "0";
      continue;
    }
    // Tabs divide the fields: images' names may hold blanks.
    std::array<std::string_view, 3> fields;
    for (std::string_view& field : fields) {
      const std::size_t end = line.find('\t');
      if (end == std::string_view::npos) {
        return reader.Error("expected IMAGE TRACK FEATURE X Y ..., with tabs");
      }
      field = line.substr(0, end);
      line.remove_prefix(end + 1);
    }
    Words numbers(line);
    OpenSfmObservation observation;
    bool ok = numbers.Next(&observation.xy_normalized.x()) &&
              numbers.Next(&observation.xy_normalized.y());
    if (has_size) ok = ok && numbers.Next(&observation.size_normalized);
    // Positions beyond the image's own size are of another image.
    if (!ok || !(observation.xy_normalized.cwiseAbs().maxCoeff() <= 1.0)) {
      return reader.Error("a number is missing or wrong");
    }
    const auto shot = shot_by_image.find(fields[0]);
    const auto point = model.point_by_track.find(base::Abseil(fields[1]));
    if (shot == shot_by_image.end() || point == model.point_by_track.end()) {
      continue;
    }
    observation.shot = shot->second;
    observation.point = point->second;
    observations.push_back(observation);
  }
  return observations;
}

}  // namespace groundlock::formats::internal
