// SPDX-License-Identifier: Apache-2.0
// OpenMVG's sfm_data.json and its .feat and .desc files as they are. The
// parsers work on bytes, so that they can be fuzzed.
// Source: OpenMVG's documentation, "OpenMVG SfM pipeline: SfM_Data"; the layout
// of the descriptors follows Rey Otero & Delbracio, "Anatomy of the SIFT
// method", IPOL 2014, section 4.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_MODEL_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_MODEL_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

struct OpenMvgView {
  std::string image;         // local_path/filename, relative to the root path
  std::uint32_t camera = 0;  // index in OpenMvgModel::cameras
  geometry::Rigid3 camera_from_world;
};

struct OpenMvgObservation {
  std::uint32_t view = 0;
  std::uint32_t feature = 0;  // index in the image's .feat and .desc
  std::uint32_t point = 0;
  Eigen::Vector2f xy_px;  // ours: first pixel's centre (0.5, 0.5)
};

struct OpenMvgModel {
  std::string root_path;                       // of the images, where it ran
  std::vector<geometry::CameraModel> cameras;  // ours
  std::vector<OpenMvgView> views;              // those with a pose
  std::vector<map::MapLandmarkData> points;
  std::vector<OpenMvgObservation> observations;
  std::vector<std::string> warnings;
};

// `file` names the text in messages; errors name the field. kUnimplemented for
// a camera that is none of ours (spherical).
absl::StatusOr<OpenMvgModel> ParseOpenMvg(std::string_view text,
                                          std::string_view file);

// A .feat file: a line "X Y SCALE ANGLE" per feature; the sizes as diameters.
struct FeatFile {
  std::vector<Eigen::Vector2f> xy_px;  // ours
  std::vector<float> sizes_px;
};
absl::StatusOr<FeatFile> ParseFeatFile(std::string_view text,
                                       std::string_view file);

// A .desc file of SIFT: a 64-bit count, then 128 bytes each, as they lie.
absl::StatusOr<std::span<const std::array<std::uint8_t, 128>>> ParseDescFile(
    std::string_view bytes, std::string_view file);

// Into the order in which COLMAP and OpenCV have the 128 numbers: OpenMVG's
// first index runs along the keypoint's direction, its second across it,
// clockwise, and its angles run clockwise.
map::Descriptor ReorderOpenMvgDescriptor(
    const std::array<std::uint8_t, 128>& descriptor);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_OPENMVG_MODEL_H_
