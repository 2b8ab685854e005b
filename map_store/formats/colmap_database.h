// SPDX-License-Identifier: Apache-2.0
// COLMAP's database.db as the place where a reconstruction begins: features
// and matches go in, COLMAP's programs work on it. What a finished map exports
// is in formats.h.
// Source: COLMAP's documentation, "Database Format".
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_COLMAP_DATABASE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_COLMAP_DATABASE_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats {

struct ColmapDatabaseCamera {
  geometry::CameraModel camera;
  // COLMAP trusts a focal length that was given more than a guessed one.
  bool focal_length_is_known = false;
};

struct ColmapDatabaseImage {
  std::string name;
  std::uint32_t camera = 0;                   // index into the cameras
  std::vector<Eigen::Vector2f> keypoints_px;  // first pixel's centre (0.5, 0.5)
  std::vector<map::Descriptor> descriptors;   // one per keypoint
};

// Features of one image that may show the same as those of another.
struct ColmapPairMatches {
  std::uint32_t image1 = 0;  // indices into the images
  std::uint32_t image2 = 0;  // another one
  std::vector<std::array<std::uint32_t, 2>> features;
};

// What COLMAP found out about a pair by its geometry.
struct ColmapVerifiedPair {
  std::uint32_t image1 = 0;  // indices into the images, image1 < image2
  std::uint32_t image2 = 0;
  int num_inliers = 0;
  // A plane or a turn on the spot explains the pair as well as motion does.
  bool is_planar_or_rotation = false;
};

// A new database with these images; image i gets the id i + 1. Whole or not at
// all; replaces what is at `path`. kInvalidArgument names an image whose
// features and descriptors differ in number.
absl::Status CreateColmapDatabase(const std::filesystem::path& path,
                                  std::span<const ColmapDatabaseCamera> cameras,
                                  std::span<const ColmapDatabaseImage> images);

// Adds unverified matches, all or none; those of pairs that are there already
// are replaced, and what COLMAP found out about those pairs is forgotten.
absl::Status AddColmapMatches(const std::filesystem::path& path,
                              std::span<const ColmapPairMatches> pairs);

// The images of a database, in the order of their ids.
absl::StatusOr<std::vector<ColmapDatabaseImage>> ReadColmapFeatures(
    const std::filesystem::path& path);

// The pairs that COLMAP verified (image1 and image2 index the images in the
// order of their ids), with those that failed as having no inliers.
absl::StatusOr<std::vector<ColmapVerifiedPair>> ReadColmapVerifiedPairs(
    const std::filesystem::path& path);

}  // namespace groundlock::formats

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_COLMAP_DATABASE_H_
