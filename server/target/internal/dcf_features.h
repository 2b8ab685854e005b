// SPDX-License-Identifier: Apache-2.0
// What the discriminative correlation filter sees of a patch.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FEATURES_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FEATURES_H_

#include <array>
#include <cstdint>
#include <vector>

#include "server/target/internal/gradient_histogram.h"
#include "server/target/internal/patch_sampler.h"

namespace groundlock::target::internal {

// Per cell of 4 x 4 samples 18 signed orientations and 4 texture energies of
// gradient_histogram.h, and the mean of ten colour names (the eleventh is what
// is missing to 1). The nine unsigned orientations are left out: they are
// nearly sums of the signed ones. Either kind is scaled to a mean square of 1
// (as STRCF does), then windowed by a raised cosine. Not thread-safe.
class DcfFeatures {
 public:
  static constexpr int kChannels = 32;

  // Without colour names their channels are zero.
  DcfFeatures(int cells, bool colour_names);

  // `sampler` holds a patch of (4 cells)^2 samples. Writes kChannels / 16
  // blocks of cells^2 groups of 16 channels.
  void Compute(const PatchSampler& sampler, float* blocks);

 private:
  void NameColours(const PatchSampler& sampler);

  int cells_;
  bool colour_names_;
  GradientHistogram gradients_;
  int row_floats_;  // of a row of cells: kChannels rows
  std::vector<float> rows_;
  std::vector<float> window_;  // cells, in whole vectors
  // The colour names' cells of two rows of samples.
  std::array<std::vector<std::int32_t>, 2> colours_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FEATURES_H_
