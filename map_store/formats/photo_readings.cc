// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/photo_readings.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "map_store/base/status.h"
#include "map_store/formats/exif.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/geometry/geodesy.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::size_t kMaxPhotos = 1'000'000;
constexpr double kUnitTolerance = 1e-3;
constexpr double kFarthest_m = 1e6;

json ToJson(const Eigen::Vector3d& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

}  // namespace

absl::StatusOr<std::vector<map::PhotoReading>> ReadPhotoReadings(
    const fs::path& folder) {
  ASSIGN_OR_RETURN(const std::vector<fs::path> photos, ListPhotos(folder));
  std::vector<map::PhotoReading> readings;
  std::vector<std::optional<geometry::GeodeticPosition>> places;
  std::vector<geometry::GeodeticPosition> known_places;
  for (const fs::path& photo : photos) {
    const auto head = ReadExifHead(photo);
    if (!head.ok()) continue;
    const auto place = GpsFromExif(*head);
    const auto up_camera = UpFromAttitude(*head);
    if (!place && !up_camera) continue;
    readings.push_back({photo.filename().string(), up_camera, std::nullopt});
    places.push_back(place);
    if (place) known_places.push_back(*place);
  }
  if (known_places.empty()) return readings;
  const geometry::GeodeticPosition origin = geometry::MiddleOf(known_places);
  for (std::size_t i = 0; i < readings.size(); ++i) {
    if (!places[i]) continue;
    const Eigen::Vector3d p_local_m =
        geometry::WorldFromGeodetic(origin, *places[i]);
    // What lies on another continent is a receiver's error, of which the file
    // would be refused.
    if (p_local_m.norm() < kFarthest_m) readings[i].p_local_m = p_local_m;
  }
  return readings;
}

std::string PhotoReadingsToJson(std::span<const map::PhotoReading> readings) {
  json photos = json::array();
  for (const map::PhotoReading& reading : readings) {
    json photo = {{"image", reading.image}};
    if (reading.up_camera) photo["up_camera"] = ToJson(*reading.up_camera);
    if (reading.p_local_m) photo["p_local_m"] = ToJson(*reading.p_local_m);
    photos.push_back(std::move(photo));
  }
  // Names may be of any bytes.
  return json{{"photos", std::move(photos)}}.dump(
             1, ' ', false, json::error_handler_t::replace) +
         "\n";
}

absl::StatusOr<std::vector<map::PhotoReading>> ParsePhotoReadings(
    std::string_view text, std::string_view file) {
  ASSIGN_OR_RETURN(const json document, internal::ParseJson(text, file));
  const internal::JsonNode root(document, file);
  ASSIGN_OR_RETURN(const internal::JsonNode photos, root.Field("photos"));
  RETURN_IF_ERROR(photos.CheckIsArray());
  if (photos.size() > kMaxPhotos) return photos.Error("too many photos");
  std::vector<map::PhotoReading> readings;
  readings.reserve(photos.size());
  for (std::size_t i = 0; i < photos.size(); ++i) {
    const internal::JsonNode photo = photos.Element(i);
    map::PhotoReading& reading = readings.emplace_back();
    ASSIGN_OR_RETURN(reading.image, photo.String("image"));
    if (photo.Has("up_camera")) {
      ASSIGN_OR_RETURN(reading.up_camera, photo.Vector3("up_camera"));
      if (!(std::abs(reading.up_camera->norm() - 1.0) < kUnitTolerance)) {
        return photo.Error("up_camera: not of length 1");
      }
      reading.up_camera->normalize();
    }
    if (photo.Has("p_local_m")) {
      ASSIGN_OR_RETURN(reading.p_local_m, photo.Vector3("p_local_m"));
      if (!(reading.p_local_m->norm() <= kFarthest_m)) {
        return photo.Error("p_local_m: farther away than 1,000 km");
      }
    }
  }
  return readings;
}

}  // namespace groundlock::formats
