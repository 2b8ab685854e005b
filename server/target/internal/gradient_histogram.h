// SPDX-License-Identifier: Apache-2.0
// Histograms of oriented gradients over a grid of cells.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_GRADIENT_HISTOGRAM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_GRADIENT_HISTOGRAM_H_

#include <cstdint>
#include <vector>

namespace groundlock::target::internal {

// The 31 features of P. Felzenszwalb, R. Girshick, D. McAllester, D. Ramanan,
// "Object detection with discriminatively trained part-based models", PAMI
// 2010, section 6, of square patches with cells of 4 pixels: 18 signed and 9
// unsigned orientations, and 4 texture energies. Each pixel votes by its
// gradient's magnitude, of the colour where that is largest, for the nearest
// orientation, shared bilinearly between the four nearest cells. Unlike there,
// the cells at the rim are kept, normalised by blocks that repeat the rim.
// Keeps its buffers between calls. Not thread-safe.
class GradientHistogram {
 public:
  static constexpr int kCellPx = 4;
  static constexpr int kSigned = 18;
  static constexpr int kUnsigned = 9;
  static constexpr int kTexture = 4;
  static constexpr int kFeatures = kSigned + kUnsigned + kTexture;

  // At least 3 cells either way. The unsigned orientations, which are nearly
  // sums of the signed ones, can be left out.
  explicit GradientHistogram(int cells, bool with_unsigned = true);

  // From a feature of a row of cells to the next one's: `cells` and what makes
  // whole vectors of them.
  int pitch() const { return pitch_; }
  // `planes` are three colours of (cells * kCellPx)^2 values in [0, 255], row
  // by row. Feature f of cell (x, y) goes to out[y * row_floats + f * pitch() +
  // x]; what is between cells and pitch() has no meaning.
  void Compute(const float* const planes[3], float* out, int row_floats);

 private:
  void VoteRow(const float* const planes[3], int y);

  int cells_;
  bool with_unsigned_;
  int pitch_;
  // From a row of cells and the rim on either side to the next one.
  int rim_pitch_;
  // Of the current row of pixels: the gradient, its squared length, where it
  // votes and what it gives to the four cells around.
  std::vector<float> dx_, dy_, squared_, votes_;
  std::vector<std::int32_t> place_;
  // kSigned rows of pairs: the cells above and below the current row of pixels.
  std::vector<float> voted_;
  std::vector<float> bins_;    // cells x kSigned rows
  std::vector<float> energy_;  // cells rows
  std::vector<float> norm_;    // cells + 1 rows, of the blocks between cells
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_GRADIENT_HISTOGRAM_H_
