// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/describe_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/core/version.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

#include "absl/status/status.h"
#include "map_store/base/status.h"
#include "map_store/features/sift_features.h"

namespace groundlock::features {
namespace {

// Lower than usual: a keypoint is wanted wherever the other tool had one.
constexpr double kContrastThreshold = 0.005;
constexpr int kLayers = 3;
constexpr double kSigma = 1.6;

// OpenCV's pixel centres are at 0; until 4.8 its SIFT is a quarter of a pixel
// too far right and down (opencv/opencv issue 23123).
constexpr float kShift_px =
    CV_VERSION_MAJOR < 4 || (CV_VERSION_MAJOR == 4 && CV_VERSION_MINOR < 8)
        ? 0.25F
        : 0.5F;

absl::StatusOr<cv::Mat> ReadLuma(decoding::ImageReader& reader,
                                 const std::filesystem::path& path,
                                 cv::Size* full_size) {
  ASSIGN_OR_RETURN(cv::Mat luma, reader.ReadLuma(path));
  *full_size = luma.size();
  const double factor =
      static_cast<double>(kMaxSide_px) / std::max(luma.cols, luma.rows);
  if (factor < 1.0) {
    cv::Mat reduced;
    cv::resize(luma, reduced, {}, factor, factor, cv::INTER_AREA);
    luma = reduced;
  }
  return luma;
}

// Keypoints by the pixel they lie in, for a search around a point.
class KeypointGrid {
 public:
  KeypointGrid(const std::vector<cv::KeyPoint>& keypoints, cv::Size size)
      : keypoints_(keypoints),
        columns_(size.width / kCell + 1),
        rows_(size.height / kCell + 1),
        cells_(static_cast<std::size_t>(columns_) *
               static_cast<std::size_t>(rows_)) {
    for (std::size_t i = 0; i < keypoints.size(); ++i) {
      cells_[CellOf(Column(keypoints[i].pt.x), Row(keypoints[i].pt.y))]
          .push_back(i);
    }
  }

  // The nearest keypoint within `radius`; of several at one place (a keypoint
  // with two orientations) that of the stronger response. -1 if none.
  int Nearest(cv::Point2f point, float radius) const {
    int best = -1;
    float best_squared = radius * radius;
    for (int r = Row(point.y - radius); r <= Row(point.y + radius); ++r) {
      for (int c = Column(point.x - radius); c <= Column(point.x + radius);
           ++c) {
        for (const std::size_t i : cells_[CellOf(c, r)]) {
          const cv::Point2f delta = keypoints_[i].pt - point;
          const float squared = delta.dot(delta);
          if (squared > best_squared) continue;
          if (best >= 0 && squared == best_squared &&
              keypoints_[i].response <=
                  keypoints_[static_cast<std::size_t>(best)].response) {
            continue;
          }
          best = static_cast<int>(i);
          best_squared = squared;
        }
      }
    }
    return best;
  }

 private:
  static constexpr int kCell = 8;
  int Column(float x) const {
    return static_cast<int>(
        std::clamp(x / kCell, 0.0F, static_cast<float>(columns_ - 1)));
  }
  int Row(float y) const {
    return static_cast<int>(
        std::clamp(y / kCell, 0.0F, static_cast<float>(rows_ - 1)));
  }
  std::size_t CellOf(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column);
  }

  const std::vector<cv::KeyPoint>& keypoints_;
  int columns_;
  int rows_;
  std::vector<std::vector<std::size_t>> cells_;
};

// OpenCV's scale space knows a keypoint's octave and layer by a packed number:
// size = 2 sigma 2^(octave + layer / 3), octave from -1, layer 1 to 3.
int PackedOctave(float size) {
  const double level = std::log2(std::max(size / (2.0 * kSigma), 1e-3));
  const int octave =
      std::max(-1, static_cast<int>(std::floor(level - 1.0 / kLayers + 1e-6)));
  const int layer = std::clamp(
      static_cast<int>(std::lround((level - octave) * kLayers)), 1, kLayers);
  return (octave & 255) | (layer << 8);
}

// The main direction of the gradients around a point, degrees in OpenCV's
// sense (clockwise from x). Lowe 2004, section 5, on the image smoothed to the
// keypoint's scale.
float MainOrientation_deg(const cv::Mat& luma, cv::Point2f point, float size) {
  constexpr int kBins = 36;
  const double sigma = 1.5 * 0.5 * size;
  const int radius = static_cast<int>(std::lround(3.0 * sigma));
  std::array<double, kBins> histogram{};
  const int x0 = static_cast<int>(std::lround(point.x));
  const int y0 = static_cast<int>(std::lround(point.y));
  for (int y = std::max(1, y0 - radius);
       y <= std::min(luma.rows - 2, y0 + radius);
       ++y) {
    for (int x = std::max(1, x0 - radius);
         x <= std::min(luma.cols - 2, x0 + radius);
         ++x) {
      const double dx =
          luma.at<std::uint8_t>(y, x + 1) - luma.at<std::uint8_t>(y, x - 1);
      const double dy =
          luma.at<std::uint8_t>(y + 1, x) - luma.at<std::uint8_t>(y - 1, x);
      const double squared =
          static_cast<double>((x - x0) * (x - x0) + (y - y0) * (y - y0));
      const double weight =
          std::hypot(dx, dy) * std::exp(-squared / (2.0 * sigma * sigma));
      const double turn = std::atan2(dy, dx) / (2.0 * std::numbers::pi);
      const int bin =
          static_cast<int>(std::lround((turn + 1.0) * kBins)) % kBins;
      histogram.at(static_cast<std::size_t>(bin)) += weight;
    }
  }
  const auto peak = std::max_element(histogram.begin(), histogram.end());
  return static_cast<float>(
      360.0 * static_cast<double>(peak - histogram.begin()) / kBins);
}

float MedianSize(const std::vector<cv::KeyPoint>& keypoints) {
  constexpr float kUsual_px = 4.0F;
  if (keypoints.empty()) return kUsual_px;
  std::vector<float> sizes;
  sizes.reserve(keypoints.size());
  for (const cv::KeyPoint& keypoint : keypoints) sizes.push_back(keypoint.size);
  const auto middle =
      sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle;
}

// One keypoint per point, in the reduced image; class_id is the point's index.
std::vector<cv::KeyPoint> KeypointsAt(
    const cv::Mat& luma,
    const std::vector<cv::KeyPoint>& detected,
    std::span<const Eigen::Vector2f> points_px,
    std::span<const float> sizes_px,
    Eigen::Vector2f factor,
    std::size_t* num_detected) {
  const KeypointGrid grid(detected, luma.size());
  const float usual_size = MedianSize(detected);
  std::vector<cv::KeyPoint> keypoints;
  keypoints.reserve(points_px.size());
  for (std::size_t i = 0; i < points_px.size(); ++i) {
    const cv::Point2f point(points_px[i].x() * factor.x() - kShift_px,
                            points_px[i].y() * factor.y() - kShift_px);
    const int nearest = grid.Nearest(point, static_cast<float>(kMaxOffset_px));
    cv::KeyPoint keypoint;
    if (nearest >= 0) {
      keypoint = detected[static_cast<std::size_t>(nearest)];
      ++*num_detected;
    } else {
      keypoint.pt = {
          std::clamp(point.x, 0.0F, static_cast<float>(luma.cols - 1)),
          std::clamp(point.y, 0.0F, static_cast<float>(luma.rows - 1))};
      const float given =
          sizes_px.empty() ? usual_size : sizes_px[i] * factor.x();
      keypoint.size =
          std::clamp(std::isfinite(given) ? given : usual_size, 2.0F, 64.0F);
      keypoint.octave = PackedOctave(keypoint.size);
      keypoint.angle = MainOrientation_deg(luma, keypoint.pt, keypoint.size);
    }
    keypoint.class_id = static_cast<int>(i);
    keypoints.push_back(keypoint);
  }
  return keypoints;
}

}  // namespace

absl::StatusOr<DescribedPoints> DescribePoints(
    decoding::ImageReader& reader,
    const std::filesystem::path& image,
    std::span<const Eigen::Vector2f> points_px,
    std::span<const float> sizes_px) {
  if (!sizes_px.empty() && sizes_px.size() != points_px.size()) {
    return absl::InvalidArgumentError(absl::StrCat(
        points_px.size(), " points but ", sizes_px.size(), " sizes"));
  }
  cv::Size full_size;
  ASSIGN_OR_RETURN(const cv::Mat luma, ReadLuma(reader, image, &full_size));
  DescribedPoints result;
  result.width_px = full_size.width;
  result.height_px = full_size.height;
  result.descriptors.resize(points_px.size());
  const Eigen::Vector2f factor(
      static_cast<float>(luma.cols) / static_cast<float>(full_size.width),
      static_cast<float>(luma.rows) / static_cast<float>(full_size.height));
  try {
    const auto sift = cv::SIFT::create(0, kLayers, kContrastThreshold);
    std::vector<cv::KeyPoint> detected;
    sift->detect(luma, detected);
    std::vector<cv::KeyPoint> keypoints = KeypointsAt(
        luma, detected, points_px, sizes_px, factor, &result.num_detected);
    cv::Mat descriptors;
    if (!keypoints.empty()) sift->compute(luma, keypoints, descriptors);
    for (std::size_t i = 0; i < keypoints.size(); ++i) {
      result.descriptors[static_cast<std::size_t>(keypoints[i].class_id)] =
          RootSift(std::span<const float, 128>(
              descriptors.ptr<float>(static_cast<int>(i)), 128));
    }
  } catch (const cv::Exception& error) {
    return absl::InternalError(
        absl::StrCat(image.string(), ": SIFT: ", error.err));
  }
  return result;
}

}  // namespace groundlock::features
