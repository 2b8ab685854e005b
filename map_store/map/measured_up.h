// SPDX-License-Identifier: Apache-2.0
// Up as images tell it beside the landmarks in them: the angles of gimbals, the
// positions of satellite receivers, and the edges of what stands upright.
#ifndef GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_
#define GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "map_store/map/map_data.h"

namespace groundlock::map {

// What a photo says of how it was taken, beside what it shows.
struct PhotoReading {
  std::string image;  // file name
  // Up in the camera's frame (x right, y down, z forward), unit.
  std::optional<Eigen::Vector3d> up_camera;
  // East, north and up of an origin that all readings of a map share, metres.
  std::optional<Eigen::Vector3d> p_local_m;
};

// What the upright edges in a map's images point at.
struct UprightEdges {
  Eigen::Vector3d up_world = Eigen::Vector3d::UnitZ();  // unit
  int count = 0;
};

struct UpReadings {
  std::vector<PhotoReading> photos;
  std::optional<UprightEdges> edges;  // in the present world of the map
};

// Up in the present world of `data`, whose poses turn the photos' readings:
//   attitudes  at least three, of which two thirds must agree; sigma is their
//              scatter, and what gimbals may have in common;
//   positions  the similarity that brings the cameras there, which two thirds
//              must support; sigma is by how much their heights scatter over
//              how far they spread across their way;
//   edges      as they are, to a degree, unless cameras would climb along them.
// nullopt if there is none, or if they are off by more than 5 degrees; what
// contradicts the map or another one is said in `warnings`. Readings of images
// that the map has not are skipped. Deterministic.
std::optional<MeasuredUp> MeasureUp(const UpReadings& readings,
                                    const MapData& data,
                                    std::vector<std::string>& warnings);

// Up as the ways tell it in which cameras are held: a guess, off by ten degrees
// where all look the same way. z without views.
Eigen::Vector3d UpByCameras(const MapData& data);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_
