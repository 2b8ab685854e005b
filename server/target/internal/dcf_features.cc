// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/dcf_features.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "server/target/colour_names.h"
#include "server/target/internal/lane_transform.h"
#include "server/target/internal/spectrum.h"

namespace groundlock::target::internal {
namespace {

constexpr int kCellPx = GradientHistogram::kCellPx;
constexpr int kNamePitch = 12;
constexpr int kNames = 10;
constexpr int kGroup = LaneTransform::kCellFloats;

// The factor that makes the mean square 1.
float UnitScale(double sum_of_squares, double count) {
  return sum_of_squares > 0.0
             ? static_cast<float>(std::sqrt(count / sum_of_squares))
             : 0.0F;
}

}  // namespace

DcfFeatures::DcfFeatures(int cells, bool colour_names)
    : cells_(cells),
      colour_names_(colour_names),
      gradients_(cells),
      histogram_(static_cast<std::size_t>(cells) * cells *
                 GradientHistogram::kFeatures),
      names_(static_cast<std::size_t>(cells) * cells * kNamePitch),
      window_(HannWindow(cells)) {}

// Every second sample of every second row says enough about a mean.
void DcfFeatures::AddColourNames(const PatchSampler& sampler) {
  const ColourNameTable& table = ColourNameTable::Get();
  const int side = cells_ * kCellPx;
  constexpr int kStep = 2;
  constexpr int kSamples = (kCellPx / kStep) * (kCellPx / kStep);
  constexpr float kShare = 1.0F / kSamples;
  std::fill(names_.begin(), names_.end(), 0.0F);
  for (int y = 0; y < side; y += kStep) {
    float* row =
        &names_[static_cast<std::size_t>(y / kCellPx) * cells_ * kNamePitch];
    const std::size_t first = static_cast<std::size_t>(y) * side;
    for (int x = 0; x < side; x += kStep) {
      const auto value = [&](int channel) {
        return static_cast<std::uint8_t>(sampler.plane(channel)[first + x]);
      };
      const ColourNameVector& names = table.At(value(2), value(1), value(0));
      float* __restrict sum = row + (x / kCellPx) * kNamePitch;
      for (int i = 0; i < kColourNames; ++i) sum[i] += kShare * names[i];
    }
  }
}

void DcfFeatures::Compute(const PatchSampler& sampler, float* blocks) {
  const std::array<const float*, 3> planes = {sampler.plane(0).data(),
                                              sampler.plane(1).data(),
                                              sampler.plane(2).data()};
  gradients_.Compute(
      planes.data(), histogram_.data(), GradientHistogram::kFeatures);
  if (colour_names_) AddColourNames(sampler);
  const int cells = cells_ * cells_;
  double gradient_energy = 0.0;
  double name_energy = 0.0;
  for (int cell = 0; cell < cells; ++cell) {
    const float* histogram = &histogram_[static_cast<std::size_t>(cell) *
                                         GradientHistogram::kFeatures];
    float sum = 0.0F;
    for (int i = 0; i < GradientHistogram::kSigned; ++i) {
      sum += histogram[i] * histogram[i];
    }
    for (int i = 0; i < GradientHistogram::kTexture; ++i) {
      const float value = histogram[GradientHistogram::kSigned +
                                    GradientHistogram::kUnsigned + i];
      sum += value * value;
    }
    gradient_energy += sum;
    const float* names = &names_[static_cast<std::size_t>(cell) * kNamePitch];
    sum = 0.0F;
    for (int i = 0; i < kNames; ++i) sum += names[i] * names[i];
    name_energy += sum;
  }
  const float gradient_scale =
      UnitScale(gradient_energy, static_cast<double>(cells) * kGradients);
  const float name_scale =
      UnitScale(name_energy, static_cast<double>(cells) * kNames);

  std::array<float, kChannels> channel;
  for (int y = 0; y < cells_; ++y) {
    for (int x = 0; x < cells_; ++x) {
      const std::size_t cell = static_cast<std::size_t>(y) * cells_ + x;
      const float window = window_[y] * window_[x];
      const float* histogram = &histogram_[cell * GradientHistogram::kFeatures];
      const float* names = &names_[cell * kNamePitch];
      for (int i = 0; i < GradientHistogram::kSigned; ++i) {
        channel[i] = histogram[i] * (window * gradient_scale);
      }
      for (int i = 0; i < GradientHistogram::kTexture; ++i) {
        channel[GradientHistogram::kSigned + i] =
            histogram[GradientHistogram::kSigned +
                      GradientHistogram::kUnsigned + i] *
            (window * gradient_scale);
      }
      for (int i = 0; i < kNames; ++i) {
        channel[kGradients + i] = names[i] * (window * name_scale);
      }
      for (int block = 0; block < kChannels / kGroup; ++block) {
        std::copy_n(
            &channel[block * kGroup],
            kGroup,
            blocks + (static_cast<std::size_t>(block) * cells + cell) * kGroup);
      }
    }
  }
}

}  // namespace groundlock::target::internal
