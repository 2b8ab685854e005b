// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/terrain/elevation_model.h"

namespace groundlock::terrain {
namespace {

using nlohmann::json;

// GDAL's own limit of a side; what is larger is no size.
constexpr double kMostCells = 2'147'483'647.0;
constexpr double kMetresOfDegree = 111'320.0;  // of a meridian, to 0.6 %

absl::Status Invalid(std::string_view what) {
  return absl::InvalidArgumentError(base::Abseil(what));
}

// "NAME" of KEYWORD["NAME", in a text of coordinate systems (ISO 19162); empty:
// there is none.
std::string NameAfter(std::string_view wkt, std::string_view keyword) {
  const std::string opening = std::string(keyword) + "[\"";
  const std::size_t at = wkt.find(opening);
  if (at == std::string_view::npos) return {};
  const std::size_t first = at + opening.size();
  const std::size_t end = wkt.find('"', first);
  if (end == std::string_view::npos) return {};
  return std::string(wkt.substr(first, end - first));
}

// What of the heights a coordinate system says.
absl::Status ReadDatum(std::string_view wkt, ElevationModelInfo& info) {
  const std::size_t vertical = wkt.find("VERTCRS[");
  if (vertical == std::string_view::npos) {
    // Three ellipsoidal axes, of which the third is the height.
    if (wkt.find("CS[ellipsoidal,3]") != std::string_view::npos) {
      info.datum = VerticalDatum{VerticalDatum::Kind::kEllipsoid, {}};
    }
    return absl::OkStatus();
  }
  const std::string_view system = wkt.substr(vertical);
  const std::string unit = NameAfter(system, "LENGTHUNIT");
  if (!unit.empty() && unit != "metre" && unit != "meter") {
    return Invalid("its heights are in " + unit + ", must be metres");
  }
  const std::string name = NameAfter(system, "VERTCRS");
  if (absl::StrContains(base::Abseil(name), "EGM96")) {
    info.datum = VerticalDatum{VerticalDatum::Kind::kEgm96, {}};
  } else if (absl::StrContains(base::Abseil(name), "EGM2008")) {
    info.datum = VerticalDatum{VerticalDatum::Kind::kEgm2008, {}};
  } else {
    info.foreign_datum = name;
  }
  return absl::OkStatus();
}

absl::Status ReadUnit(const json& root) {
  const json& bands = root.at("bands");
  if (bands.size() != 1) {
    return Invalid("it has " + std::to_string(bands.size()) +
                   " bands, must be one of heights");
  }
  const std::string unit = bands.at(0).value("unit", "");
  if (unit.empty() || unit == "m" || unit == "metre" || unit == "meter" ||
      unit == "metres" || unit == "meters") {
    return absl::OkStatus();
  }
  return Invalid("its heights are in " + unit + ", must be metres");
}

absl::Status ReadExtent(const json& root, ElevationModelInfo& info) {
  const auto extent = root.find("wgs84Extent");
  if (extent == root.end()) return Invalid("it has no place on Earth");
  for (const json& corner : extent->at("coordinates").at(0)) {
    const geometry::GeodeticPosition place{
        corner.at(1).get<double>(), corner.at(0).get<double>(), 0.0};
    if (!place.Validate().ok()) return Invalid("it has no place on Earth");
    info.window.Include(place);
  }
  const GeodeticWindow& w = info.window;
  if (!(w.east_deg > w.west_deg && w.north_deg > w.south_deg)) {
    return Invalid("it has no extent on Earth");
  }
  const double middle_rad =
      0.5 * (w.south_deg + w.north_deg) * std::numbers::pi / 180.0;
  info.cell_m =
      kMetresOfDegree *
      std::min((w.north_deg - w.south_deg) / static_cast<double>(info.rows),
               (w.east_deg - w.west_deg) * std::cos(middle_rad) /
                   static_cast<double>(info.columns));
  if (!(info.cell_m > 0.0)) return Invalid("it has no extent on Earth");
  return absl::OkStatus();
}

absl::StatusOr<ElevationModelInfo> FromJson(const json& root) {
  ElevationModelInfo info;
  const json& size = root.at("size");
  const double columns = size.at(0).get<double>();
  const double rows = size.at(1).get<double>();
  if (!(columns >= 1.0 && columns <= kMostCells && rows >= 1.0 &&
        rows <= kMostCells)) {
    return absl::DataLossError("its size is absurd");
  }
  info.columns = static_cast<std::size_t>(columns);
  info.rows = static_cast<std::size_t>(rows);
  const auto system = root.find("coordinateSystem");
  if (system == root.end() || system->value("wkt", "").empty()) {
    return Invalid("it has no coordinate system, so no place on Earth");
  }
  RETURN_IF_ERROR(ReadUnit(root));
  RETURN_IF_ERROR(ReadDatum(system->at("wkt").get<std::string>(), info));
  RETURN_IF_ERROR(ReadExtent(root, info));
  return info;
}

}  // namespace

absl::StatusOr<ElevationModelInfo> ParseElevationModelInfo(
    std::string_view text) {
  // Warnings may stand before and behind it.
  const std::size_t first = text.find('{');
  const std::size_t last = text.rfind('}');
  if (first == std::string_view::npos || last == std::string_view::npos ||
      last < first) {
    return Invalid("gdalinfo printed no JSON");
  }
  const json root = json::parse(text.substr(first, last - first + 1),
                                nullptr,
                                /*allow_exceptions=*/false);
  if (root.is_discarded()) return Invalid("gdalinfo printed no JSON");
  try {
    return FromJson(root);
  } catch (const json::exception& error) {
    return Invalid(std::string("gdalinfo printed JSON of another kind: ") +
                   error.what());
  }
}

}  // namespace groundlock::terrain
