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

  explicit GradientHistogram(int cells);

  // `planes` are three colours of (cells * kCellPx)^2 values in [0, 255], row
  // by row. The features of cell (x, y) go to out[(y * cells + x) * pitch].
  void Compute(const float* const planes[3], float* out, int pitch);

 private:
  void RowGradients(const float* const planes[3], int y);
  void Vote(int y);
  void BlockNorms();
  void Describe(int x, int y, float* out) const;

  int cells_;
  // Of the current row of pixels.
  std::vector<float> dx_, dy_, magnitude_;
  std::vector<std::int32_t> orientation_;
  // (cells + 2)^2 cells of kSigned bins: a rim takes the votes that fall
  // outside.
  std::vector<float> bins_;
  std::vector<float> energy_;  // cells^2
  std::vector<float> norm_;    // (cells + 1)^2, of the blocks between cells
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_GRADIENT_HISTOGRAM_H_
