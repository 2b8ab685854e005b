// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/texture.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <opencv2/imgproc.hpp>
#include <utility>

namespace groundlock::simulator {
namespace {

using Byte4 = std::uint8_t __attribute__((vector_size(4)));

Float4 Load(const std::uint8_t* texel) {
  Byte4 bytes;
  std::memcpy(&bytes, texel, sizeof(bytes));
  return __builtin_convertvector(bytes, Float4);
}

// Of what is small enough for an int: std::floor is a call of the library where
// the processor's own rounding (SSE4.1) may not be taken for granted.
int Floor(float value) {
  const int truncated = static_cast<int>(value);
  return value < static_cast<float>(truncated) ? truncated - 1 : truncated;
}

}  // namespace

Texture::Texture(cv::Mat image, bool wrap_u) : wrap_u_(wrap_u) {
  levels_.push_back(std::move(image));
  while (levels_.back().cols > 1 || levels_.back().rows > 1) {
    const cv::Mat& finer = levels_.back();
    cv::Mat coarser;
    cv::resize(
        finer,
        coarser,
        cv::Size(std::max(1, finer.cols / 2), std::max(1, finer.rows / 2)),
        0,
        0,
        cv::INTER_AREA);
    levels_.push_back(coarser);
  }
}

Float4 Texture::Bilinear(const cv::Mat& level, float u, float v) const {
  const float x = u * static_cast<float>(level.cols) - 0.5F;
  const float y = v * static_cast<float>(level.rows) - 0.5F;
  int x0 = Floor(x);
  const int y0 = Floor(y);
  const float fx = x - static_cast<float>(x0);
  const float fy = y - static_cast<float>(y0);
  int x1 = x0 + 1;
  if (wrap_u_) {
    if (x0 < 0) x0 += level.cols;
    if (x1 >= level.cols) x1 -= level.cols;
  }
  x0 = std::clamp(x0, 0, level.cols - 1);
  x1 = std::clamp(x1, 0, level.cols - 1);
  const int last_row = level.rows - 1;
  const auto* row0 = level.ptr<std::uint8_t>(std::clamp(y0, 0, last_row));
  const auto* row1 = level.ptr<std::uint8_t>(std::clamp(y0 + 1, 0, last_row));
  const Float4 a = Load(row0 + 4 * x0);
  const Float4 b = Load(row0 + 4 * x1);
  const Float4 c = Load(row1 + 4 * x0);
  const Float4 d = Load(row1 + 4 * x1);
  const Float4 top = a + (b - a) * fx;
  const Float4 bottom = c + (d - c) * fx;
  return top + (bottom - top) * fy;
}

Float4 Texture::Sample(float u, float v, float lod) const {
  const float last = static_cast<float>(levels_.size() - 1);
  const float clamped = std::clamp(lod, 0.0F, last);
  const std::size_t level = static_cast<std::size_t>(clamped);
  const float f = clamped - static_cast<float>(level);
  const Float4 fine = Bilinear(levels_[level], u, v);
  if (f <= 0.0F || level + 1 >= levels_.size()) return fine;
  return fine + (Bilinear(levels_[level + 1], u, v) - fine) * f;
}

}  // namespace groundlock::simulator
