// SPDX-License-Identifier: Apache-2.0
// OpenSfM's reconstruction.json and tracks.csv as they are. The parsers work on
// bytes, so that they can be fuzzed.
// Source: OpenSfM's documentation, "Reconstruction file format" and "Geometric
// models" (camera models, coordinate systems).
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENSFM_MODEL_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENSFM_MODEL_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

struct OpenSfmShot {
  std::string image;
  std::uint32_t camera = 0;
  geometry::Rigid3 camera_from_world;
};

// The reconstruction with the most shots of those that the file holds.
struct OpenSfmModel {
  std::vector<geometry::CameraModel> cameras;  // by name
  std::vector<OpenSfmShot> shots;              // by name
  std::vector<map::MapLandmarkData> points;
  absl::flat_hash_map<std::string, std::uint32_t> point_by_track;
  // World is metres east, north and up of here, as GPS had it.
  std::optional<geometry::GeodeticPosition> reference;
  std::size_t num_models = 0;  // that the file holds
  std::vector<std::string> warnings;
};

// `file` names the text in messages; errors name the field. kUnimplemented for
// a camera that is none of ours (spherical).
absl::StatusOr<OpenSfmModel> ParseOpenSfm(std::string_view text,
                                          std::string_view file);

struct OpenSfmObservation {
  std::uint32_t shot = 0;
  std::uint32_t point = 0;
  // From the image's centre, in units of its larger side.
  Eigen::Vector2d xy_normalized;
  double size_normalized = 0.0;  // 0 = not given
};

// The observations of `model`'s points in its shots, in the file's order; a
// tracks.csv holds others, too. Versions 0 to 2.
absl::StatusOr<std::vector<OpenSfmObservation>> ParseOpenSfmTracks(
    std::string_view text, std::string_view file, const OpenSfmModel& model);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENSFM_MODEL_H_
