// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/photo_readings.h"

#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
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
constexpr std::int64_t kMaxEdges = 1'000'000'000;
constexpr std::uint64_t kMaxReadingsBytes = std::uint64_t{64} << 20;

json ToJson(const Eigen::Vector3d& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

absl::StatusOr<Eigen::Vector3d> Direction(const internal::JsonNode& node,
                                          const char* key) {
  ASSIGN_OR_RETURN(const Eigen::Vector3d vector, node.Vector3(key));
  if (!(std::abs(vector.norm() - 1.0) < kUnitTolerance)) {
    return node.Error(absl::StrCat(key, ": not of length 1"));
  }
  return vector.normalized();
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

std::string UpReadingsToJson(const map::UpReadings& readings) {
  json photos = json::array();
  for (const map::PhotoReading& reading : readings.photos) {
    json photo = {{"image", reading.image}};
    if (reading.up_camera) photo["up_camera"] = ToJson(*reading.up_camera);
    if (reading.p_local_m) photo["p_local_m"] = ToJson(*reading.p_local_m);
    photos.push_back(std::move(photo));
  }
  json document = {{"photos", std::move(photos)}};
  if (readings.edges) {
    document["upright_edges"] = {{"up_model", ToJson(readings.edges->up_world)},
                                 {"count", readings.edges->count}};
  }
  // Names may be of any bytes.
  return document.dump(1, ' ', false, json::error_handler_t::replace) + "\n";
}

absl::StatusOr<map::UpReadings> ReadUpReadings(const fs::path& file) {
  ASSIGN_OR_RETURN(const std::string text,
                   base::ReadFile(file, kMaxReadingsBytes));
  return ParseUpReadings(text, file.string());
}

absl::StatusOr<map::UpReadings> ParseUpReadings(std::string_view text,
                                                std::string_view file) {
  ASSIGN_OR_RETURN(const json document, internal::ParseJson(text, file));
  const internal::JsonNode root(document, file);
  ASSIGN_OR_RETURN(const internal::JsonNode photos, root.Field("photos"));
  RETURN_IF_ERROR(photos.CheckIsArray());
  if (photos.size() > kMaxPhotos) return photos.Error("too many photos");
  map::UpReadings readings;
  readings.photos.reserve(photos.size());
  for (std::size_t i = 0; i < photos.size(); ++i) {
    const internal::JsonNode photo = photos.Element(i);
    map::PhotoReading& reading = readings.photos.emplace_back();
    ASSIGN_OR_RETURN(reading.image, photo.String("image"));
    if (photo.Has("up_camera")) {
      ASSIGN_OR_RETURN(reading.up_camera, Direction(photo, "up_camera"));
    }
    if (photo.Has("p_local_m")) {
      ASSIGN_OR_RETURN(reading.p_local_m, photo.Vector3("p_local_m"));
      if (!(reading.p_local_m->norm() <= kFarthest_m)) {
        return photo.Error("p_local_m: farther away than 1,000 km");
      }
    }
  }
  if (root.Has("upright_edges")) {
    ASSIGN_OR_RETURN(const internal::JsonNode edges,
                     root.Field("upright_edges"));
    map::UprightEdges& target = readings.edges.emplace();
    ASSIGN_OR_RETURN(target.up_world, Direction(edges, "up_model"));
    ASSIGN_OR_RETURN(const std::int64_t count, edges.Integer("count"));
    if (count < 0 || count > kMaxEdges) {
      return edges.Error("count: out of range");
    }
    target.count = static_cast<int>(count);
  }
  return readings;
}

}  // namespace groundlock::formats
