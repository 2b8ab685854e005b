// SPDX-License-Identifier: Apache-2.0
// Images on the disk and their features.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_FEATURES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_FEATURES_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// Files with an image's extension, sorted by name. kNotFound without a folder,
// kInvalidArgument if there is no image in it.
absl::StatusOr<std::vector<std::filesystem::path>> ListImages(
    const std::filesystem::path& folder);

struct ImageFeatures {
  std::string name;  // the file's, without its folder
  int width_px = 0;
  int height_px = 0;
  double sharpness = 0.0;
  std::vector<Eigen::Vector2f> keypoints_px;  // first pixel's centre (0.5, 0.5)
  std::vector<map::Descriptor> descriptors;
  std::vector<std::array<std::uint8_t, 3>> rgb;  // at the keypoints
};

struct ImageFeatureOptions {
  int max_features = 6'000;
  int max_size_px =
      2'400;        // larger images are shrunk before features are found
  int threads = 0;  // 0 = all cores
};

// Runs task(i) for i in [0, count) on `threads` threads (0 = all cores) and
// calls progress(finished) from the calling thread now and then; false from
// it, or an error of a task, ends the work after the tasks under way. Returns
// the error of the lowest index, or kCancelled.
absl::Status ForEachInParallel(
    std::size_t count,
    int threads,
    const std::function<absl::Status(std::size_t)>& task,
    const std::function<bool(std::size_t)>& progress);

// SIFT of all images, in their order. Errors (decoding::ImageReader's among
// them) name the file.
absl::StatusOr<std::vector<ImageFeatures>> ExtractFeatures(
    std::span<const std::filesystem::path> images,
    const ImageFeatureOptions& options,
    const std::function<bool(std::size_t)>& progress);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_IMAGE_FEATURES_H_
