// SPDX-License-Identifier: Apache-2.0
// Descriptors of points whose position in an image is known from elsewhere: for
// reconstructions that come without descriptors.
#ifndef GROUNDLOCK_MAP_STORE_FEATURES_DESCRIBE_POINTS_H_
#define GROUNDLOCK_MAP_STORE_FEATURES_DESCRIBE_POINTS_H_

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/decoding/image_reader.h"
#include "map_store/map/map_data.h"

namespace groundlock::features {

struct DescribedPoints {
  std::vector<map::Descriptor> descriptors;  // one per point
  int width_px = 0;                          // of the image
  int height_px = 0;
  // Points at which SIFT detects a keypoint itself, so that scale and
  // orientation are what it will find in other images.
  std::size_t num_detected = 0;
};

// Describes each point as the SIFT keypoint that is detected nearest to it, if
// one is within kMaxOffset_px; else at the point itself, with the size given or
// else the image's median, and the gradients' main orientation.
//   image      as `reader` reads them; larger ones than kMaxSide_px are reduced
//   to that,
//              as SIFT takes about 500 bytes per pixel.
//   points_px  first pixel's centre (0.5, 0.5), in the image as it is stored
//              (EXIF's orientation is not applied).
//   sizes_px   diameters; empty = not known.
// kInvalidArgument: sizes differ; else errors are the reader's. Deterministic.
// Thread-safe.
// Source: Lowe 2004, as OpenCV implements it.
inline constexpr int kMaxSide_px = 1'600;
inline constexpr double kMaxOffset_px = 1.5;
absl::StatusOr<DescribedPoints> DescribePoints(
    decoding::ImageReader& reader,
    const std::filesystem::path& image,
    std::span<const Eigen::Vector2f> points_px,
    std::span<const float> sizes_px);

}  // namespace groundlock::features

#endif  // GROUNDLOCK_MAP_STORE_FEATURES_DESCRIBE_POINTS_H_
