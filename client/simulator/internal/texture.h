// SPDX-License-Identifier: Apache-2.0
// Mip-mapped textures: rendered surfaces must not shimmer from frame to frame.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TEXTURE_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TEXTURE_H_

#include <opencv2/core.hpp>
#include <vector>

namespace groundlock::simulator {

// Four channels at once (GCC's and clang's vector extension, SSE2 on x86-64).
using Float4 = float __attribute__((vector_size(16)));

class Texture {
 public:
  Texture() = default;
  // CV_8UC4; the channels' meaning is the caller's. wrap_u joins the left and
  // right edges (the side of a barrel); all other edges are continued.
  Texture(cv::Mat image, bool wrap_u);

  // Trilinear. u, v in [0, 1] from the top-left corner; lod is log2 of the
  // footprint in texels of the full texture. Channels in [0, 255].
  Float4 Sample(float u, float v, float lod) const;

 private:
  Float4 Bilinear(const cv::Mat& level, float u, float v) const;

  std::vector<cv::Mat> levels_;
  bool wrap_u_ = false;
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TEXTURE_H_
