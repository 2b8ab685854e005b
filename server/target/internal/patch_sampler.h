// SPDX-License-Identifier: Apache-2.0
// Resamples any box of an image to a fixed square patch.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_PATCH_SAMPLER_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_PATCH_SAMPLER_H_

#include <array>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "map_store/geometry/box.h"

namespace groundlock::target::internal {

// Cubic resampling (Keys 1981, a = -1/2) with edge replication outside the
// image. Where the patch is 2.5 times as coarse as the image, or more, that is
// halved first, pixels averaged in fours; where it is coarser still, the kernel
// is widened, so that nothing aliases up to ten pixels a cell. The cost is
// bounded whatever the box. Keeps its buffers between calls. Not thread-safe.
class PatchSampler {
 public:
  explicit PatchSampler(int cells);

  // `image` is CV_8UC3 (BGR) or CV_8UC1 and not empty, `box_px` finite and of
  // positive size. Afterwards plane(c) holds cells x cells values in [0, 255],
  // row by row; all planes of a gray image are equal.
  void Sample(const cv::Mat& image, const geometry::Box2& box_px);

  int cells() const { return cells_; }
  // How many times an image can be halved before sampling a box of `size_px`
  // without the patch becoming coarser.
  int Halvings(const Eigen::Vector2d& size_px) const;
  // 0 blue, 1 green, 2 red.
  const std::vector<float>& plane(int channel) const {
    return planes_[channel];
  }

 private:
  friend struct StateFields;

  // For every cell along an axis the pixels that it reads and their weights.
  struct Taps {
    int count = 0;              // pixels a cell reads
    int begin = 0, end = 0;     // pixels that any cell reads, within the image
    std::vector<int> index;     // cells x count, clamped into the image
    std::vector<float> weight;  // cells x count
  };
  void FillTaps(double min_px,
                double extent_px,
                int image_px,
                Taps& taps) const;
  void HalvePixels(const cv::Mat& image, int pitch, cv::Mat& out);
  void SampleHalved(const cv::Mat& image, const geometry::Box2& box_px);
  // Some rows of the patch from row `y` on: as many as a vector holds.
  void SampleRows(const cv::Mat& image, int y);

  int cells_;
  Taps horizontal_, vertical_;
  std::vector<int> offsets_;         // horizontal_.index in columns_
  std::vector<float> columns_;       // of the rows in work, one after the other
  std::vector<std::uint8_t> means_;  // of four pixels, from each of a row's on
  std::array<std::vector<std::uint8_t>, 2> halves_;
  std::array<std::vector<float>, 3> planes_;
};

// What sampling any box within `box_px` with so many cells or more reads: the
// kernel reaches beyond it.
geometry::Box2 ReachOf(const geometry::Box2& box_px, int cells);

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_PATCH_SAMPLER_H_
