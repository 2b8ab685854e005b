// SPDX-License-Identifier: Apache-2.0
// Places on Earth, and worlds that lie there. WGS84 throughout; GeographicLib
// does the geodesy.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_GEODESY_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_GEODESY_H_

#include <Eigen/Core>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::geometry {

struct GeodeticPosition {
  double latitude_deg = 0.0;   // -90 to 90, north positive
  double longitude_deg = 0.0;  // -180 to 180, east positive
  double height_m = 0.0;       // above the ellipsoid, within 100 km

  absl::Status Validate() const;  // kInvalidArgument names field and value
  friend bool operator==(const GeodeticPosition&,
                         const GeodeticPosition&) = default;
};

// A georeferenced world: x east, y north, z up (along the ellipsoid's normal)
// at its origin, metres. Both ways are exact to a micrometre within 100 km of
// the origin; the Earth's curvature is part of it: a place at the origin's
// height and 1 km away has z = -8 cm.
//   origin  must be valid.
Eigen::Vector3d WorldFromGeodetic(const GeodeticPosition& origin,
                                  const GeodeticPosition& place);
GeodeticPosition GeodeticFromWorld(const GeodeticPosition& origin,
                                   const Eigen::Vector3d& p_world);

// From the world at one origin to that at another: over some kilometres they
// differ by a rotation, too.
Rigid3 WorldFromWorld(const GeodeticPosition& target_origin,
                      const GeodeticPosition& source_origin);

// The middle of places that are near to each other (far less than a hemisphere
// apart); N >= 1.
GeodeticPosition MiddleOf(std::span<const GeodeticPosition> places);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_GEODESY_H_
