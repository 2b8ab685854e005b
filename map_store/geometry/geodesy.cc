// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/geodesy.h"

#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>
#include <numbers>

#include "absl/strings/str_cat.h"

namespace groundlock::geometry {
namespace {

constexpr double kMaxHeight_m = 100'000.0;

GeographicLib::LocalCartesian LocalAt(const GeodeticPosition& origin) {
  return GeographicLib::LocalCartesian(
      origin.latitude_deg, origin.longitude_deg, origin.height_m);
}

absl::Status OutOfRange(const char* field, double value) {
  return absl::InvalidArgumentError(
      absl::StrCat(field, ": ", value, " is out of range"));
}

}  // namespace

absl::Status GeodeticPosition::Validate() const {
  if (!(std::abs(latitude_deg) <= 90.0)) {
    return OutOfRange("latitude_deg", latitude_deg);
  }
  if (!(std::abs(longitude_deg) <= 180.0)) {
    return OutOfRange("longitude_deg", longitude_deg);
  }
  if (!(std::abs(height_m) <= kMaxHeight_m)) {
    return OutOfRange("height_m", height_m);
  }
  return absl::OkStatus();
}

Eigen::Vector3d WorldFromGeodetic(const GeodeticPosition& origin,
                                  const GeodeticPosition& place) {
  Eigen::Vector3d p_world;
  LocalAt(origin).Forward(place.latitude_deg,
                          place.longitude_deg,
                          place.height_m,
                          p_world.x(),
                          p_world.y(),
                          p_world.z());
  return p_world;
}

GeodeticPosition GeodeticFromWorld(const GeodeticPosition& origin,
                                   const Eigen::Vector3d& p_world) {
  GeodeticPosition place;
  LocalAt(origin).Reverse(p_world.x(),
                          p_world.y(),
                          p_world.z(),
                          place.latitude_deg,
                          place.longitude_deg,
                          place.height_m);
  return place;
}

Rigid3 WorldFromWorld(const GeodeticPosition& target_origin,
                      const GeodeticPosition& source_origin) {
  // East, north and up at a place, as axes of the Earth's centre.
  const auto earth_from_local = [](const GeodeticPosition& origin) {
    constexpr double kRadians = std::numbers::pi / 180.0;
    return Eigen::Quaterniond(
        Eigen::AngleAxisd((90.0 + origin.longitude_deg) * kRadians,
                          Eigen::Vector3d::UnitZ()) *
        Eigen::AngleAxisd((90.0 - origin.latitude_deg) * kRadians,
                          Eigen::Vector3d::UnitX()));
  };
  return {(earth_from_local(target_origin).conjugate() *
           earth_from_local(source_origin))
              .normalized(),
          WorldFromGeodetic(target_origin, source_origin)};
}

GeodeticPosition MiddleOf(std::span<const GeodeticPosition> places) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const GeodeticPosition& place : places) {
    sum += WorldFromGeodetic(places.front(), place);
  }
  return GeodeticFromWorld(places.front(),
                           sum / static_cast<double>(places.size()));
}

}  // namespace groundlock::geometry
