// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/sift_features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core/version.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace groundlock::features {
namespace {

// OpenCV's first pixel is (0, 0), ours (0.5, 0.5).
constexpr double kPixelCenter = 0.5;
// OpenCV detects in the image at twice its size and halves the coordinates,
// but its resize maps x to 2 x + 0.5: until 4.8 every keypoint comes out a
// quarter of a pixel too far right and down (opencv/opencv issue 23123; the
// unit test measures it on blobs). At f = 1050 px that would turn the camera by
// 0.014 degrees.
constexpr bool kHasQuarterPixelShift =
    CV_VERSION_MAJOR < 4 || (CV_VERSION_MAJOR == 4 && CV_VERSION_MINOR < 8);
constexpr double kPixelCentre_px =
    kPixelCenter - (kHasQuarterPixelShift ? 0.25 : 0.0);

constexpr float kScale = 512.0F;  // COLMAP's

// Pixels whose centre lies in a mask are 0, others 255. Empty without masks.
cv::Mat MakeMask(cv::Size size_px, std::span<const geometry::Box2> masks_px) {
  if (masks_px.empty()) return {};
  cv::Mat mask(size_px, CV_8UC1, cv::Scalar(255));
  for (const geometry::Box2& box : masks_px) {
    // Clamped before the conversion: boxes may be anywhere, and !(a < b) also
    // drops those that are not a number.
    const auto first = [](double min_px, int size) {
      return static_cast<int>(
          std::clamp(std::ceil(min_px - kPixelCenter), 0.0, 1.0 * size));
    };
    if (!box.IsFinite()) continue;
    const int x0 = first(box.min_px.x(), size_px.width);
    const int y0 = first(box.min_px.y(), size_px.height);
    const int x1 = first(box.max_px.x(), size_px.width);
    const int y1 = first(box.max_px.y(), size_px.height);
    if (x0 < x1 && y0 < y1) {
      mask(cv::Rect(x0, y0, x1 - x0, y1 - y0)).setTo(0);
    }
  }
  return mask;
}

}  // namespace

map::Descriptor RootSift(std::span<const float, 128> sift) {
  float sum = 0.0F;
  for (const float value : sift) sum += std::max(value, 0.0F);
  map::Descriptor root{};
  if (!(sum > 0.0F)) return root;
  for (std::size_t i = 0; i < root.size(); ++i) {
    const float value = kScale * std::sqrt(std::max(sift[i], 0.0F) / sum);
    root[i] =
        static_cast<std::uint8_t>(std::clamp(std::lround(value), 0L, 255L));
  }
  return root;
}

Eigen::Vector2d PixelOfSift(const cv::KeyPoint& keypoint) {
  return {keypoint.pt.x + kPixelCentre_px, keypoint.pt.y + kPixelCentre_px};
}

absl::StatusOr<SiftFeatures> ExtractSift(
    const cv::Mat& luma,
    std::span<const geometry::Box2> masks_px,
    const SiftOptions& options) {
  if (luma.empty() || luma.type() != CV_8UC1) {
    return absl::InvalidArgumentError("SIFT needs an 8-bit gray image");
  }
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  Eigen::Vector2d full_from_reduced = Eigen::Vector2d::Ones();
  try {
    cv::Mat mask = MakeMask(luma.size(), masks_px);
    cv::Mat reduced = luma;
    if (options.halvings > 0) {
      const cv::Size size_px(std::max(1, luma.cols >> options.halvings),
                             std::max(1, luma.rows >> options.halvings));
      full_from_reduced = {static_cast<double>(luma.cols) / size_px.width,
                           static_cast<double>(luma.rows) / size_px.height};
      cv::resize(luma, reduced, size_px, 0.0, 0.0, cv::INTER_AREA);
      if (!mask.empty()) {
        cv::resize(mask, mask, size_px, 0.0, 0.0, cv::INTER_NEAREST);
      }
    }
    cv::SIFT::create(options.max_features, 3, options.contrast_threshold)
        ->detectAndCompute(reduced, mask, keypoints, descriptors);
  } catch (const cv::Exception& error) {
    return absl::InternalError(absl::StrCat("SIFT: ", error.err));
  }
  SiftFeatures features;
  features.keypoints_px.reserve(keypoints.size());
  features.descriptors.reserve(keypoints.size());
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    features.keypoints_px.emplace_back(
        full_from_reduced.cwiseProduct(PixelOfSift(keypoints[i])));
    features.descriptors.push_back(RootSift(std::span<const float, 128>(
        descriptors.ptr<float>(static_cast<int>(i)), 128)));
  }
  return features;
}

}  // namespace groundlock::features
