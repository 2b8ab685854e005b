// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/dcf_features.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "server/target/colour_names.h"
#include "server/target/internal/lane_transform.h"
#include "server/target/internal/spectrum.h"
#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

constexpr int kGradients =
    GradientHistogram::kSigned + GradientHistogram::kTexture;
constexpr int kNames = 10;
constexpr int kGroup = LaneTransform::kCellFloats;
static_assert(kGradients + kNames == DcfFeatures::kChannels);

// What a row of cells is multiplied by.
struct RowScales {
  float window, gradients, names;
};

// The factor that makes the mean square 1.
float UnitScale(double sum_of_squares, double count) {
  return sum_of_squares > 0.0
             ? static_cast<float>(std::sqrt(count / sum_of_squares))
             : 0.0F;
}

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/feature_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

DcfFeatures::DcfFeatures(int cells, bool colour_names)
    : cells_(cells),
      colour_names_(colour_names),
      gradients_(cells, /*with_unsigned=*/false),
      row_floats_(kChannels * gradients_.pitch()),
      rows_(static_cast<std::size_t>(cells) * row_floats_),
      window_(HannWindow(cells)) {
  window_.resize(gradients_.pitch());
  for (auto& row : colours_) {
    row.resize(static_cast<std::size_t>(cells) * GradientHistogram::kCellPx);
  }
}

// Every second sample of every second row says enough about a mean.
void DcfFeatures::NameColours(const PatchSampler& sampler) {
  const ColourNameTable& table = ColourNameTable::Get();
  const int side = cells_ * GradientHistogram::kCellPx;
  const std::array<const std::int32_t*, 2> colours = {colours_[0].data(),
                                                      colours_[1].data()};
  for (int y = 0; y < cells_; ++y) {
    for (int i = 0; i < 2; ++i) {
      const std::size_t first =
          static_cast<std::size_t>(y * GradientHistogram::kCellPx + 2 * i) *
          side;
      const std::array<const float*, 3> planes = {&sampler.plane(0)[first],
                                                  &sampler.plane(1)[first],
                                                  &sampler.plane(2)[first]};
      GROUNDLOCK_WIDEST(RowColours)(planes.data(), side, colours_[i].data());
    }
    GROUNDLOCK_WIDEST(RowNames)
    (table,
     colours.data(),
     cells_,
     gradients_.pitch(),
     &rows_[static_cast<std::size_t>(y) * row_floats_ +
            static_cast<std::size_t>(kGradients) * gradients_.pitch()]);
  }
}

void DcfFeatures::Compute(const PatchSampler& sampler, float* blocks) {
  const std::array<const float*, 3> planes = {sampler.plane(0).data(),
                                              sampler.plane(1).data(),
                                              sampler.plane(2).data()};
  gradients_.Compute(planes.data(), rows_.data(), row_floats_);
  if (colour_names_) NameColours(sampler);
  const int pitch = gradients_.pitch();
  double gradient_energy = 0.0;
  double name_energy = 0.0;
  for (int y = 0; y < cells_; ++y) {
    const float* row = &rows_[static_cast<std::size_t>(y) * row_floats_];
    gradient_energy = GROUNDLOCK_WIDEST(AddEnergy)(
        row, kGradients, cells_, pitch, gradient_energy);
    name_energy = GROUNDLOCK_WIDEST(AddEnergy)(
        row + static_cast<std::ptrdiff_t>(kGradients) * pitch,
        kNames,
        cells_,
        pitch,
        name_energy);
  }
  const double cells = static_cast<double>(cells_) * cells_;
  RowScales scales;
  scales.gradients = UnitScale(gradient_energy, cells * kGradients);
  scales.names = UnitScale(name_energy, cells * kNames);
  const std::size_t row_groups = static_cast<std::size_t>(cells_) * kGroup;
  for (int y = 0; y < cells_; ++y) {
    scales.window = window_[y];
    GROUNDLOCK_WIDEST(PutRow)
    (&rows_[static_cast<std::size_t>(y) * row_floats_],
     cells_,
     pitch,
     window_.data(),
     scales,
     row_groups * cells_,
     blocks + y * row_groups);
  }
}

}  // namespace groundlock::target::internal
