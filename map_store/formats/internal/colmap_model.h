// SPDX-License-Identifier: Apache-2.0
// A COLMAP sparse model as its three files say it (cameras, images, points3D),
// and what they mean together. The parsers work on bytes, so that they can be
// fuzzed. Source: COLMAP's documentation, "Output Format"; camera models and
// ids from "Camera Models".
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_COLMAP_MODEL_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_COLMAP_MODEL_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

struct ColmapCamera {
  std::uint32_t id = 0;
  geometry::CameraModel camera;
};

// A 2D point that observes a 3D point; the others only count.
struct ColmapFeature {
  std::uint64_t point_id = 0;
  Eigen::Vector2f xy_px;
  std::uint32_t index = 0;  // among all 2D points of the image
};

struct ColmapImage {
  std::uint32_t id = 0;
  std::uint32_t camera_id = 0;
  std::string name;
  geometry::Rigid3 camera_from_world;
  std::uint64_t num_points2d = 0;
  std::vector<ColmapFeature> features;  // by index
};

struct ColmapPoint {
  std::uint64_t id = 0;
  map::MapLandmarkData landmark;
  std::uint64_t track_length = 0;
};

struct ColmapTrackElement {
  std::uint32_t image_id = 0;
  std::uint32_t index = 0;  // of the 2D point
};

struct ColmapModel {
  std::vector<ColmapCamera> cameras;
  std::vector<ColmapImage> images;
  std::vector<ColmapPoint> points;
  std::vector<ColmapTrackElement> tracks;  // of points[0], points[1], ...
};

// Each appends one file's content to `model`. `file` names it in messages.
// kInvalidArgument says where and what; kUnimplemented names a camera model
// that is not supported and the camera.
absl::Status ParseColmapCamerasBinary(std::string_view bytes,
                                      std::string_view file,
                                      ColmapModel* model);
absl::Status ParseColmapImagesBinary(std::string_view bytes,
                                     std::string_view file,
                                     ColmapModel* model);
absl::Status ParseColmapPointsBinary(std::string_view bytes,
                                     std::string_view file,
                                     ColmapModel* model);
absl::Status ParseColmapCamerasText(std::string_view text,
                                    std::string_view file,
                                    ColmapModel* model);
absl::Status ParseColmapImagesText(std::string_view text,
                                   std::string_view file,
                                   ColmapModel* model);
absl::Status ParseColmapPointsText(std::string_view text,
                                   std::string_view file,
                                   ColmapModel* model);

// camera_from_world of a file's q = (w, x, y, z), normalised, and t.
// kInvalidArgument (without a place) if q is zero or anything is not finite.
absl::StatusOr<geometry::Rigid3> RigidFromFile(
    const std::array<double, 4>& q_wxyz, const std::array<double, 3>& t);
// kInvalidArgument (without a place) for an empty name, one that is too long,
// or one with control characters.
absl::Status CheckImageName(std::string_view name);

// Which features of an image were kept, to find their descriptors.
struct FeatureOrigin {
  std::uint64_t num_features = 0;    // that the source image has
  std::vector<std::uint32_t> index;  // per feature kept
};

struct LinkedModel {
  map::MapData data;                   // without descriptors
  std::vector<FeatureOrigin> origins;  // per view
};

// Resolves ids to indices: views and landmarks in the order of their ids.
// kInvalidArgument names the image or point with a duplicate or dangling id.
absl::StatusOr<LinkedModel> LinkColmapModel(ColmapModel model,
                                            std::vector<std::string>* warnings);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_COLMAP_MODEL_H_
