// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/gradient_histogram.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/core/hal/intrin.hpp>

namespace groundlock::target::internal {
namespace {

constexpr int kCellPx = GradientHistogram::kCellPx;
constexpr int kSigned = GradientHistogram::kSigned;
constexpr int kUnsigned = GradientHistogram::kUnsigned;
// Of a cell: its bins, then zeros.
constexpr int kBinPitch = 20;
constexpr float kClip = 0.2F;
// Of values in [0, 255]; the paper's features are of [0, 1], where its
// reference code adds 1e-4 to the squared norm.
constexpr float kNormFloor = 1e-4F * 255.0F * 255.0F;
// Scales the texture energies to the range of the others, 1 / sqrt(18).
constexpr float kTextureScale = 0.2357F;

// The directions half way between the orientations 0, 20, .. 80 degrees.
struct Borders {
  std::array<float, 4> cos, sin;
};

Borders OrientationBorders() {
  Borders borders;
  for (int i = 0; i < 4; ++i) {
    const double angle = std::numbers::pi * (2 * i + 1) / kSigned;
    borders.cos[i] = static_cast<float>(std::cos(angle));
    borders.sin[i] = static_cast<float>(std::sin(angle));
  }
  return borders;
}

}  // namespace

GradientHistogram::GradientHistogram(int cells)
    : cells_(cells),
      dx_(cells * kCellPx),
      dy_(dx_.size()),
      magnitude_(dx_.size()),
      orientation_(dx_.size()),
      // Describe reads past the bins of the last cell that counts, not past the
      // rim.
      bins_(static_cast<std::size_t>(cells + 2) * (cells + 2) * kBinPitch),
      energy_(static_cast<std::size_t>(cells) * cells),
      norm_(static_cast<std::size_t>(cells + 1) * (cells + 1)) {}

// The gradient of the colour where it is longest, its length, and the nearest
// of the 18 orientations.
void GradientHistogram::RowGradients(const float* const planes[3], int y) {
  const int side = cells_ * kCellPx;
  float* __restrict dx = dx_.data();
  float* __restrict dy = dy_.data();
  float* __restrict magnitude = magnitude_.data();
  for (const int x : {0, side - 1}) dx[x] = dy[x] = magnitude[x] = 0.0F;
  const std::ptrdiff_t to_above = -std::min(y, 1) * side;
  const std::ptrdiff_t to_below = y < side - 1 ? side : 0;
  // The compiler makes branches of these choices. The last vector overlaps the
  // one before, which changes nothing.
  for (int begin = 1; begin < side - 1; begin += 4) {
    const int x = std::min(begin, side - 5);
    cv::v_float32x4 longest = cv::v_setzero_f32();
    cv::v_float32x4 across = cv::v_setzero_f32();
    cv::v_float32x4 along = cv::v_setzero_f32();
    for (int c = 0; c < 3; ++c) {
      const float* at = planes[c] + y * side + x;
      const cv::v_float32x4 gx = cv::v_load(at + 1) - cv::v_load(at - 1);
      const cv::v_float32x4 gy =
          cv::v_load(at + to_below) - cv::v_load(at + to_above);
      const cv::v_float32x4 squared = gx * gx + gy * gy;
      const cv::v_float32x4 longer = squared > longest;
      across = cv::v_select(longer, gx, across);
      along = cv::v_select(longer, gy, along);
      longest = cv::v_max(squared, longest);
    }
    cv::v_store(dx + x, across);
    cv::v_store(dy + x, along);
    cv::v_store(magnitude + x, longest);
  }

  // Count the borders that the direction, folded into the first quadrant, has
  // passed, then unfold.
  static const Borders borders = OrientationBorders();
  std::int32_t* __restrict orientation = orientation_.data();
  for (int x = 0; x < side; ++x) {
    const float across = std::abs(dx[x]);
    const float along = std::abs(dy[x]);
    std::int32_t index = 0;
    for (int i = 0; i < 4; ++i) {
      index += along * borders.cos[i] > across * borders.sin[i] ? 1 : 0;
    }
    index = dx[x] < 0.0F ? kUnsigned - index : index;
    index = dy[x] < 0.0F ? kSigned - index : index;
    orientation[x] = index == kSigned ? 0 : index;
  }
  Eigen::Map<Eigen::ArrayXf> length(magnitude, side);
  length = length.sqrt();
}

void GradientHistogram::Vote(int y) {
  // A pixel's centre between the centres of the two nearest cells: the share of
  // the cell before, by the pixel's place in the period of four.
  constexpr std::array<float, kCellPx> kShareBefore = {
      0.375F, 0.125F, 0.875F, 0.625F};
  constexpr std::array<int, kCellPx> kCellBefore = {0, 0, 1, 1};  // in the rim
  const int row_floats = (cells_ + 2) * kBinPitch;
  const float above = kShareBefore[y % kCellPx];
  float* upper =
      bins_.data() + (y / kCellPx + kCellBefore[y % kCellPx]) * row_floats;
  float* lower = upper + row_floats;
  const std::int32_t* orientation = orientation_.data();
  const float* magnitude = magnitude_.data();
  for (int cell = 0; cell < cells_; ++cell) {
    for (int i = 0; i < kCellPx; ++i) {
      const int at = (cell + kCellBefore[i]) * kBinPitch + *orientation++;
      const float vote = *magnitude++;
      const float left = kShareBefore[i] * vote;
      const float right = vote - left;
      const float upper_left = above * left;
      const float upper_right = above * right;
      upper[at] += upper_left;
      upper[at + kBinPitch] += upper_right;
      lower[at] += left - upper_left;
      lower[at + kBinPitch] += right - upper_right;
    }
  }
}

void GradientHistogram::BlockNorms() {
  for (int y = 0; y < cells_; ++y) {
    for (int x = 0; x < cells_; ++x) {
      const float* __restrict bin =
          &bins_[((y + 1) * (cells_ + 2) + x + 1) * kBinPitch];
      float sum = 0.0F;
      for (int i = 0; i < kUnsigned; ++i) {
        const float both = bin[i] + bin[i + kUnsigned];
        sum += both * both;
      }
      energy_[y * cells_ + x] = sum;
    }
  }
  for (int y = 0; y <= cells_; ++y) {
    const float* above = &energy_[std::max(0, y - 1) * cells_];
    const float* below = &energy_[std::min(cells_ - 1, y) * cells_];
    for (int x = 0; x <= cells_; ++x) {
      const int left = std::max(0, x - 1);
      const int right = std::min(cells_ - 1, x);
      norm_[y * (cells_ + 1) + x] =
          1.0F / std::sqrt(above[left] + above[right] + below[left] +
                           below[right] + kNormFloor);
    }
  }
}

void GradientHistogram::Describe(int x, int y, float* __restrict out) const {
  const float* __restrict bin =
      &bins_[((y + 1) * (cells_ + 2) + x + 1) * kBinPitch];
  const float* norm = &norm_[y * (cells_ + 1) + x];
  const std::array<float, 4> norms = {
      norm[0], norm[1], norm[cells_ + 1], norm[cells_ + 2]};
  // Two bins beyond the last come along, so that the loops are of whole
  // vectors; they are zero.
  std::array<float, kBinPitch> sum = {};
  const cv::v_float32x4 clip = cv::v_setall_f32(kClip);
  std::array<cv::v_float32x4, 4> texture;
  texture.fill(cv::v_setzero_f32());
  for (int i = 0; i < kBinPitch; i += 4) {
    const cv::v_float32x4 bins = cv::v_load(bin + i);
    cv::v_float32x4 total = cv::v_setzero_f32();
    for (int n = 0; n < 4; ++n) {
      const cv::v_float32x4 value =
          cv::v_min(bins * cv::v_setall_f32(norms[n]), clip);
      total += value;
      texture[n] += value;
    }
    cv::v_store(sum.data() + i, total);
  }
  for (int n = 0; n < 4; ++n) {
    out[kSigned + kUnsigned + n] = kTextureScale * cv::v_reduce_sum(texture[n]);
  }
  for (int i = 0; i < kSigned; ++i) out[i] = 0.5F * sum[i];
  // Three bins beyond the ninth, which count for nothing.
  for (int i = 0; i < kUnsigned; i += 4) {
    const cv::v_float32x4 both =
        cv::v_load(bin + i) + cv::v_load(bin + i + kUnsigned);
    cv::v_float32x4 total = cv::v_setzero_f32();
    for (int n = 0; n < 4; ++n) {
      total += cv::v_min(both * cv::v_setall_f32(norms[n]), clip);
    }
    cv::v_store(sum.data() + i, total);
  }
  for (int i = 0; i < kUnsigned; ++i) out[kSigned + i] = 0.5F * sum[i];
}

void GradientHistogram::Compute(const float* const planes[3],
                                float* out,
                                int pitch) {
  std::fill(bins_.begin(), bins_.end(), 0.0F);
  for (int y = 0; y < cells_ * kCellPx; ++y) {
    RowGradients(planes, y);
    Vote(y);
  }
  BlockNorms();
  for (int y = 0; y < cells_; ++y) {
    for (int x = 0; x < cells_; ++x) {
      Describe(x, y, out + static_cast<std::size_t>(y * cells_ + x) * pitch);
    }
  }
}

}  // namespace groundlock::target::internal
