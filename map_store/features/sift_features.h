// SPDX-License-Identifier: Apache-2.0
// SIFT of an image in the form in which maps hold it.
#ifndef GROUNDLOCK_MAP_STORE_FEATURES_SIFT_FEATURES_H_
#define GROUNDLOCK_MAP_STORE_FEATURES_SIFT_FEATURES_H_

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/map/map_data.h"

namespace groundlock::features {

struct SiftOptions {
  int max_features = 12'000;
  // OpenCV's measure; its default 0.04 leaves about half as many inliers.
  double contrast_threshold = 0.02;
  // The image is halved so many times first: a quarter of the cost each, and
  // without the features of its finest octave.
  int halvings = 0;
};

// Keypoints and descriptors, paired by index.
struct SiftFeatures {
  std::vector<Eigen::Vector2d> keypoints_px;  // first pixel's centre (0.5, 0.5)
  std::vector<map::Descriptor> descriptors;
};

// RootSIFT (Arandjelovic & Zisserman 2012) in 8 bits: L1-normalised, square
// root, times 512. A zero vector stays zero.
map::Descriptor RootSift(std::span<const float, 128> sift);

// Where cv::SIFT's keypoint lies in the image that it was found in; first
// pixel's centre (0.5, 0.5).
Eigen::Vector2d PixelOfSift(const cv::KeyPoint& keypoint);

// Features of a CV_8UC1 image, without those inside `masks_px`. Deterministic.
// kInvalidArgument if the image is empty or of another type.
// Source: Lowe 2004, as OpenCV implements it.
absl::StatusOr<SiftFeatures> ExtractSift(
    const cv::Mat& luma,
    std::span<const geometry::Box2> masks_px,
    const SiftOptions& options);

}  // namespace groundlock::features

#endif  // GROUNDLOCK_MAP_STORE_FEATURES_SIFT_FEATURES_H_
