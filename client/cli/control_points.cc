// SPDX-License-Identifier: Apache-2.0
#include "client/cli/control_points.h"

#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using base::Abseil;
using nlohmann::json;

absl::Status NotOfForm(std::string_view text, std::string_view form) {
  return absl::InvalidArgumentError(
      absl::StrCat("\"", Abseil(text), "\" is not ", Abseil(form)));
}

// Finite numbers between commas; empty if one is none.
std::vector<double> Numbers(std::string_view text) {
  std::vector<double> numbers;
  while (true) {
    const std::size_t comma = text.find(',');
    std::string_view word = text.substr(0, comma);
    while (!word.empty() && word.front() == ' ') word.remove_prefix(1);
    while (!word.empty() && word.back() == ' ') word.remove_suffix(1);
    double number = 0.0;
    const char* end = word.data() + word.size();
    const auto [stop, error] = std::from_chars(word.data(), end, number);
    if (word.empty() || error != std::errc{} || stop != end ||
        !std::isfinite(number)) {
      return {};
    }
    numbers.push_back(number);
    if (comma == std::string_view::npos) return numbers;
    text.remove_prefix(comma + 1);
  }
}

absl::StatusOr<std::vector<double>> NumbersOf(const json& object,
                                              const char* key,
                                              std::size_t count) {
  const auto field = object.find(key);
  if (field == object.end() || !field->is_array() || field->size() != count) {
    return absl::InvalidArgumentError(absl::StrCat(
        "field \"", key, "\" must be an array of ", count, " numbers"));
  }
  std::vector<double> numbers;
  for (const json& value : *field) {
    if (!value.is_number() || !std::isfinite(value.get<double>())) {
      return absl::InvalidArgumentError(
          absl::StrCat("field \"", key, "\" holds what is no number"));
    }
    numbers.push_back(value.get<double>());
  }
  return numbers;
}

absl::StatusOr<sdk::MapPoint> PointOf(const json& object) {
  sdk::MapPoint point;
  if (object.contains("position")) {
    ASSIGN_OR_RETURN(const auto p, NumbersOf(object, "position", 3));
    point.position_world = Eigen::Vector3d(p[0], p[1], p[2]);
    return point;
  }
  const auto pixels = object.find("pixels");
  if (pixels == object.end() || !pixels->is_array()) {
    return absl::InvalidArgumentError(
        "needs a field \"position\" or \"pixels\"");
  }
  for (const json& pixel : *pixels) {
    if (!pixel.is_object() || !pixel.contains("image") ||
        !pixel["image"].is_string()) {
      return absl::InvalidArgumentError("a pixel needs a field \"image\"");
    }
    ASSIGN_OR_RETURN(const auto xy, NumbersOf(pixel, "xy", 2));
    point.pixels.push_back({pixel["image"].get<std::string>(), {xy[0], xy[1]}});
  }
  return point;
}

absl::StatusOr<sdk::Place> PlaceOf(const json& object) {
  const auto place = object.find("place");
  if (place != object.end() && place->is_object()) {
    geometry::GeodeticPosition position;
    for (const auto& [key, target] :
         {std::pair{"latitude_deg", &position.latitude_deg},
          std::pair{"longitude_deg", &position.longitude_deg},
          std::pair{"height_m", &position.height_m}}) {
      const auto field = place->find(key);
      if (field == place->end() || !field->is_number()) {
        return absl::InvalidArgumentError(
            absl::StrCat("its place needs a number \"", key, "\""));
      }
      *target = field->get<double>();
    }
    RETURN_IF_ERROR(position.Validate());
    return sdk::Place(position);
  }
  ASSIGN_OR_RETURN(const auto p, NumbersOf(object, "place", 3));
  return sdk::Place(Eigen::Vector3d(p[0], p[1], p[2]));
}

absl::StatusOr<sdk::AlignRequest::ControlPoint> ControlPointOf(
    const json& object, const std::string& name) {
  sdk::AlignRequest::ControlPoint point;
  point.name = name;
  ASSIGN_OR_RETURN(point.point, PointOf(object));
  ASSIGN_OR_RETURN(point.place, PlaceOf(object));
  return point;
}

}  // namespace

absl::StatusOr<std::vector<sdk::AlignRequest::ControlPoint>>
ControlPointsFromJson(std::string_view text) {
  const json document = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!document.is_object() || !document.contains("points") ||
      !document["points"].is_array()) {
    return absl::InvalidArgumentError(
        "not a JSON object with an array \"points\"");
  }
  std::vector<sdk::AlignRequest::ControlPoint> points;
  for (const json& object : document["points"]) {
    std::string name = absl::StrCat("point ", points.size());
    if (!object.is_object()) {
      return absl::InvalidArgumentError(name + ": is no object");
    }
    const auto given = object.find("name");
    if (given != object.end() && given->is_string()) {
      name = given->get<std::string>();
    }
    auto point = ControlPointOf(object, name);
    if (!point.ok()) return base::Annotate(point.status(), name);
    points.push_back(*std::move(point));
  }
  return points;
}

absl::StatusOr<sdk::MapPoint> ParseMapPoint(std::string_view text) {
  constexpr std::string_view kForm =
      "X,Y,Z in the map's world or IMAGE@X,Y;IMAGE@X,Y";
  sdk::MapPoint point;
  if (text.find('@') == std::string_view::npos) {
    const std::vector<double> xyz = Numbers(text);
    if (xyz.size() != 3) return NotOfForm(text, kForm);
    point.position_world = Eigen::Vector3d(xyz[0], xyz[1], xyz[2]);
    return point;
  }
  std::string_view rest = text;
  while (!rest.empty()) {
    const std::size_t end = std::min(rest.find(';'), rest.size());
    const std::string_view part = rest.substr(0, end);
    const std::size_t at = part.rfind('@');
    if (at == std::string_view::npos || at == 0) return NotOfForm(text, kForm);
    const std::vector<double> xy = Numbers(part.substr(at + 1));
    if (xy.size() != 2) return NotOfForm(text, kForm);
    point.pixels.push_back({std::string(part.substr(0, at)), {xy[0], xy[1]}});
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  return point;
}

absl::StatusOr<geometry::GeodeticPosition> ParseGeodetic(
    std::string_view text) {
  const std::vector<double> numbers = Numbers(text);
  if (numbers.size() != 2 && numbers.size() != 3) {
    return NotOfForm(text, "LATITUDE,LONGITUDE,HEIGHT");
  }
  const geometry::GeodeticPosition position{
      numbers[0], numbers[1], numbers.size() == 3 ? numbers[2] : 0.0};
  RETURN_IF_ERROR(position.Validate());
  return position;
}

absl::Status ParseGround(std::string_view text, sdk::AlignRequest* request) {
  if (text == "auto") {
    request->ground = sdk::AlignRequest::AutomaticGround{};
    return absl::OkStatus();
  }
  const std::vector<double> n = Numbers(text);
  if (n.size() == 3) {
    request->ground = Eigen::Vector3d(n[0], n[1], n[2]);
    return absl::OkStatus();
  }
  if (n.size() != 4) {
    return NotOfForm(text, "auto, a point X,Y,Z or a plane A,B,C,D");
  }
  request->ground = geometry::Plane{{n[0], n[1], n[2]}, n[3]};
  return absl::OkStatus();
}

}  // namespace groundlock::cli
