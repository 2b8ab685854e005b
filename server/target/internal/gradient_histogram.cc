// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/gradient_histogram.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>

#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

constexpr int kCellPx = GradientHistogram::kCellPx;
constexpr int kSigned = GradientHistogram::kSigned;
constexpr float kClip = 0.2F;
// Of values in [0, 255]; the paper's features are of [0, 1], where its
// reference code adds 1e-4 to the length norm.
constexpr float kNormFloor = 1e-4F * 255.0F * 255.0F;
// Numbers below have no inverse root.
constexpr float kLeastSquared = std::numeric_limits<float>::min();
// Scales the texture energies to the range of the others, 1 / sqrt(18).
constexpr float kTextureScale = 0.2357F;
// A pixel's centre between the centres of the two nearest cells: the share of
// the cell before, by the pixel's place in the period of four, and which cell
// that is, counted with the rim.
constexpr std::array<float, 2 * kCellPx> kShareBefore = {
    0.375F, 0.125F, 0.875F, 0.625F, 0.375F, 0.125F, 0.875F, 0.625F};
constexpr std::array<int, kCellPx> kCellBefore = {0, 0, 1, 1};

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

// What the header says of the current row of pixels.
struct RowBuffers {
  float *dx, *dy, *squared, *votes;
  std::int32_t* place;
};

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/gradient_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

GradientHistogram::GradientHistogram(int cells, bool with_unsigned)
    : cells_(cells),
      with_unsigned_(with_unsigned),
      pitch_(WholeVectors(cells)),
      rim_pitch_(WholeVectors(cells + 2)),
      dx_(static_cast<std::size_t>(cells) * kCellPx),
      dy_(dx_.size()),
      squared_(dx_.size()),
      votes_(4 * dx_.size()),
      place_(dx_.size()),
      voted_(2UL * kSigned * rim_pitch_),
      // What is read of the last row begins behind the rim.
      bins_(static_cast<std::size_t>(cells) * kSigned * rim_pitch_ +
            kVectorFloats),
      energy_(static_cast<std::size_t>(cells) * rim_pitch_ + kVectorFloats),
      norm_(static_cast<std::size_t>(cells + 1) * rim_pitch_ + kVectorFloats) {}

void GradientHistogram::VoteRow(const float* const planes[3], int y) {
  const int side = cells_ * kCellPx;
  const RowBuffers row{
      dx_.data(), dy_.data(), squared_.data(), votes_.data(), place_.data()};
  const std::ptrdiff_t first = static_cast<std::ptrdiff_t>(y) * side;
  const std::array<const float*, 3> rows = {
      planes[0] + first, planes[1] + first, planes[2] + first};
  GROUNDLOCK_WIDEST(RowGradients)
  (rows.data(), side, y > 0 ? -side : 0, y < side - 1 ? side : 0, row);
  static const Borders borders = OrientationBorders();
  GROUNDLOCK_WIDEST(RowVotes)
  (side, kShareBefore[y % kCellPx], 2 * rim_pitch_, borders, row);
  GROUNDLOCK_WIDEST(AddVotes)(cells_, row, voted_.data());
}

void GradientHistogram::Compute(const float* const planes[3],
                                float* out,
                                int row_floats) {
  const auto bins = [this](int y) {
    return &bins_[static_cast<std::size_t>(y) * kSigned * rim_pitch_];
  };
  const auto energy = [this](int y) {
    return &energy_[static_cast<std::size_t>(std::clamp(y, 0, cells_ - 1)) *
                    rim_pitch_];
  };
  const auto norm = [this](int y) {
    return &norm_[static_cast<std::size_t>(y) * rim_pitch_];
  };
  std::fill(voted_.begin(), voted_.end(), 0.0F);
  const int side = cells_ * kCellPx;
  for (int y = 0; y < side; ++y) {
    VoteRow(planes, y);
    if (y + 1 < side &&
        kCellBefore[(y + 1) % kCellPx] <= kCellBefore[y % kCellPx]) {
      continue;
    }
    // Nothing more falls on the row above. The first one is the rim, which the
    // next one overwrites.
    const int row = std::max(0, y / kCellPx - 1 + kCellBefore[y % kCellPx]);
    GROUNDLOCK_WIDEST(TakeUpperRow)(rim_pitch_, voted_.data(), bins(row));
  }
  for (int y = 0; y < cells_; ++y) {
    GROUNDLOCK_WIDEST(RowEnergies)(bins(y), rim_pitch_, energy(y));
    energy(y)[0] = energy(y)[1];
    energy(y)[cells_ + 1] = energy(y)[cells_];
  }
  for (int y = 0; y <= cells_; ++y) {
    GROUNDLOCK_WIDEST(RowNorms)(energy(y - 1), energy(y), cells_, norm(y));
  }
  for (int y = 0; y < cells_; ++y) {
    GROUNDLOCK_WIDEST(RowFeatures)
    (bins(y) + 1,
     rim_pitch_,
     norm(y),
     norm(y + 1),
     with_unsigned_,
     pitch_,
     out + static_cast<std::size_t>(y) * row_floats);
  }
}

}  // namespace groundlock::target::internal
