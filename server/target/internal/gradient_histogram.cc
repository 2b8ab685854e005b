// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/gradient_histogram.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace groundlock::target::internal {
namespace {

constexpr int kCellPx = GradientHistogram::kCellPx;
constexpr int kSigned = GradientHistogram::kSigned;
constexpr int kUnsigned = GradientHistogram::kUnsigned;
constexpr float kClip = 0.2F;
// Of values in [0, 255]; the paper's features are of [0, 1], where its
// reference code adds 1e-4 to the squared norm.
constexpr float kNormFloor = 1e-4F * 255.0F * 255.0F;
// Scales the texture energies to the range of the others, 1 / sqrt(18).
constexpr float kTextureScale = 0.2357F;

struct Directions {
  std::array<float, kUnsigned> cos, sin;
};

Directions UnsignedDirections() {
  Directions d;
  for (int i = 0; i < kUnsigned; ++i) {
    const double angle = std::numbers::pi * i / kUnsigned;
    d.cos[i] = static_cast<float>(std::cos(angle));
    d.sin[i] = static_cast<float>(std::sin(angle));
  }
  return d;
}

}  // namespace

GradientHistogram::GradientHistogram(int cells)
    : cells_(cells),
      dx_(cells * kCellPx),
      dy_(dx_.size()),
      magnitude_(dx_.size()),
      orientation_(dx_.size()),
      bins_(static_cast<std::size_t>(cells + 2) * (cells + 2) * kSigned),
      energy_(static_cast<std::size_t>(cells) * cells),
      norm_(static_cast<std::size_t>(cells + 1) * (cells + 1)) {}

// The gradient of the colour where it is longest, its length, and the nearest
// of the 18 orientations.
void GradientHistogram::RowGradients(const float* const planes[3], int y) {
  const int side = cells_ * kCellPx;
  float* __restrict dx = dx_.data();
  float* __restrict dy = dy_.data();
  float* __restrict magnitude = magnitude_.data();
  std::fill(magnitude_.begin(), magnitude_.end(), -1.0F);
  for (int c = 0; c < 3; ++c) {
    const float* __restrict row = planes[c] + y * side;
    const float* __restrict above = planes[c] + std::max(0, y - 1) * side;
    const float* __restrict below =
        planes[c] + std::min(side - 1, y + 1) * side;
    for (int x = 1; x < side - 1; ++x) {
      const float gx = row[x + 1] - row[x - 1];
      const float gy = below[x] - above[x];
      const float squared = gx * gx + gy * gy;
      const bool longer = squared > magnitude[x];
      dx[x] = longer ? gx : dx[x];
      dy[x] = longer ? gy : dy[x];
      magnitude[x] = longer ? squared : magnitude[x];
    }
  }
  // The outermost columns have no neighbour to differ from.
  dx[0] = dy[0] = magnitude[0] = 0.0F;
  dx[side - 1] = dy[side - 1] = magnitude[side - 1] = 0.0F;

  static const Directions directions = UnsignedDirections();
  std::int32_t* __restrict orientation = orientation_.data();
  for (int x = 0; x < side; ++x) {
    float best = 0.0F;
    std::int32_t best_index = 0;
    for (int i = 0; i < kUnsigned; ++i) {
      const float along = directions.cos[i] * dx[x] + directions.sin[i] * dy[x];
      const float length = std::abs(along);
      const std::int32_t index = along < 0.0F ? i + kUnsigned : i;
      best_index = length > best ? index : best_index;
      best = length > best ? length : best;
    }
    orientation[x] = best_index;
    magnitude[x] = std::sqrt(magnitude[x]);
  }
}

void GradientHistogram::Vote(int y) {
  // A pixel's centre between the centres of the two nearest cells: the share of
  // the cell before, by the pixel's place in the period of four.
  constexpr std::array<float, kCellPx> kShareBefore = {
      0.375F, 0.125F, 0.875F, 0.625F};
  constexpr std::array<int, kCellPx> kCellBefore = {0, 0, 1, 1};  // in the rim
  const int row_floats = (cells_ + 2) * kSigned;
  const float above = kShareBefore[y % kCellPx];
  float* upper =
      bins_.data() + (y / kCellPx + kCellBefore[y % kCellPx]) * row_floats;
  float* lower = upper + row_floats;
  const std::int32_t* orientation = orientation_.data();
  const float* magnitude = magnitude_.data();
  for (int cell = 0; cell < cells_; ++cell) {
    for (int i = 0; i < kCellPx; ++i) {
      const int at = (cell + kCellBefore[i]) * kSigned + *orientation++;
      const float vote = *magnitude++;
      const float left = kShareBefore[i] * vote;
      const float right = vote - left;
      const float upper_left = above * left;
      const float upper_right = above * right;
      upper[at] += upper_left;
      upper[at + kSigned] += upper_right;
      lower[at] += left - upper_left;
      lower[at + kSigned] += right - upper_right;
    }
  }
}

void GradientHistogram::BlockNorms() {
  for (int y = 0; y < cells_; ++y) {
    for (int x = 0; x < cells_; ++x) {
      const float* __restrict bin =
          &bins_[((y + 1) * (cells_ + 2) + x + 1) * kSigned];
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
      &bins_[((y + 1) * (cells_ + 2) + x + 1) * kSigned];
  const float* norm = &norm_[y * (cells_ + 1) + x];
  const std::array<float, 4> norms = {
      norm[0], norm[1], norm[cells_ + 1], norm[cells_ + 2]};
  std::array<float, 4> texture = {};
  for (int i = 0; i < kSigned; ++i) {
    float sum = 0.0F;
    for (int n = 0; n < 4; ++n) {
      const float value = std::min(bin[i] * norms[n], kClip);
      sum += value;
      texture[n] += value;
    }
    out[i] = 0.5F * sum;
  }
  for (int i = 0; i < kUnsigned; ++i) {
    const float both = bin[i] + bin[i + kUnsigned];
    float sum = 0.0F;
    for (int n = 0; n < 4; ++n) sum += std::min(both * norms[n], kClip);
    out[kSigned + i] = 0.5F * sum;
  }
  for (int n = 0; n < 4; ++n) {
    out[kSigned + kUnsigned + n] = kTextureScale * texture[n];
  }
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
