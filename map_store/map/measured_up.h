// SPDX-License-Identifier: Apache-2.0
// Up as the sensors of photos tell it: the angles of gimbals, and the positions
// of satellite receivers.
#ifndef GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_
#define GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_

#include <Eigen/Core>
#include <optional>
#include <span>
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

// Up in the present world of `data`, whose poses turn the photos' readings:
//   attitudes  at least three, of which two thirds must agree; sigma is their
//              scatter, and what gimbals may have in common;
//   positions  the similarity that brings the cameras there, which two thirds
//              must support; sigma is by how much their heights scatter over
//              how far they spread across their way.
// nullopt if there is neither, or if they are off by more than 5 degrees; what
// contradicts the map or the other kind is said in `warnings`. Readings of
// images that the map has not are skipped. Deterministic.
std::optional<MeasuredUp> MeasureUp(std::span<const PhotoReading> readings,
                                    const MapData& data,
                                    std::vector<std::string>& warnings);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_MEASURED_UP_H_
