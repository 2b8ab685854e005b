// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/patch_sampler.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core/hal/intrin.hpp>

namespace groundlock::target::internal {
namespace {

constexpr double kWidestKernel = 4.0;  // pixels a cell, beyond it may alias

double CubicKernel(double x) {
  x = std::abs(x);
  if (x < 1.0) return (1.5 * x - 2.5) * x * x + 1.0;
  if (x < 2.0) return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0;
  return 0.0;
}

// accumulator += weight * pixels
void AddRow(const std::uint8_t* __restrict pixels,
            float weight,
            int count,
            float* __restrict accumulator) {
  for (int i = 0; i < count; ++i) {
    accumulator[i] += weight * static_cast<float>(pixels[i]);
  }
}

}  // namespace

PatchSampler::PatchSampler(int cells) : cells_(cells) {
  const auto most =
      static_cast<std::size_t>(cells * std::ceil(4.0 * kWidestKernel));
  for (Taps* taps : {&horizontal_, &vertical_}) {
    taps->index.reserve(most);
    taps->weight.reserve(most);
  }
  for (auto& plane : planes_) {
    plane.resize(static_cast<std::size_t>(cells_) * cells_);
  }
}

geometry::Box2 ReachOf(const geometry::Box2& box_px) {
  constexpr double kReachPx = 2.0 * kWidestKernel + 1.0;
  return {box_px.min_px.array() - kReachPx, box_px.max_px.array() + kReachPx};
}

void PatchSampler::FillTaps(double min_px,
                            double extent_px,
                            int image_px,
                            Taps& taps) const {
  const double step = extent_px / cells_;
  const double width = std::clamp(step, 1.0, kWidestKernel);
  taps.count = static_cast<int>(std::ceil(4.0 * width));
  taps.index.resize(static_cast<std::size_t>(cells_) * taps.count);
  taps.weight.resize(taps.index.size());
  taps.begin = image_px;
  taps.end = 0;
  for (int cell = 0; cell < cells_; ++cell) {
    // In pixel indices, clamped so far outside that nothing but the edge pixel
    // is read: keeps the integers small whatever the box.
    const double center =
        std::clamp(min_px + (cell + 0.5) * step - 0.5, -64.0, image_px + 64.0);
    const int first = static_cast<int>(std::ceil(center - 2.0 * width));
    int* index = &taps.index[static_cast<std::size_t>(cell) * taps.count];
    float* weight = &taps.weight[static_cast<std::size_t>(cell) * taps.count];
    double sum = 0.0;
    for (int t = 0; t < taps.count; ++t) {
      sum += CubicKernel((first + t - center) / width);
    }
    for (int t = 0; t < taps.count; ++t) {
      index[t] = std::clamp(first + t, 0, image_px - 1);
      weight[t] =
          static_cast<float>(CubicKernel((first + t - center) / width) / sum);
      taps.begin = std::min(taps.begin, index[t]);
      taps.end = std::max(taps.end, index[t] + 1);
    }
  }
}

void PatchSampler::ReduceGrayRow(int y) {
  const int* index = horizontal_.index.data();
  const float* weight = horizontal_.weight.data();
  for (int x = 0; x < cells_; ++x) {
    float sum = 0.0F;
    for (int t = 0; t < horizontal_.count; ++t) {
      sum += *weight++ * row_[*index++ - horizontal_.begin];
    }
    // Cubic weights overshoot at edges.
    for (auto& plane : planes_) {
      plane[static_cast<std::size_t>(y) * cells_ + x] =
          std::clamp(sum, 0.0F, 255.0F);
    }
  }
}

// A pixel and the next one's first value make a vector.
void PatchSampler::ReduceColourRow(int y) {
  const int* index = horizontal_.index.data();
  const float* weight = horizontal_.weight.data();
  const cv::v_float32x4 darkest = cv::v_setzero_f32();
  const cv::v_float32x4 brightest = cv::v_setall_f32(255.0F);
  for (int x = 0; x < cells_; ++x) {
    cv::v_float32x4 sum = cv::v_setzero_f32();
    for (int t = 0; t < horizontal_.count; ++t) {
      const float* value = &row_[(*index++ - horizontal_.begin) * 3];
      sum += cv::v_setall_f32(*weight++) * cv::v_load(value);
    }
    std::array<float, 4> colour;
    cv::v_store(colour.data(), cv::v_min(cv::v_max(sum, darkest), brightest));
    for (int c = 0; c < 3; ++c) {
      planes_[c][static_cast<std::size_t>(y) * cells_ + x] = colour[c];
    }
  }
}

void PatchSampler::Sample(const cv::Mat& image, const geometry::Box2& box_px) {
  FillTaps(box_px.x(), box_px.width(), image.cols, horizontal_);
  FillTaps(box_px.y(), box_px.height(), image.rows, vertical_);
  const int channels = image.channels();
  const int row_values = (horizontal_.end - horizontal_.begin) * channels;
  // A whole row fits, so that a box that grows asks for nothing more;
  // ReduceColourRow reads one more.
  row_.reserve(static_cast<std::size_t>(image.cols) * channels + 1);
  row_.resize(row_values + 1);
  for (int y = 0; y < cells_; ++y) {
    std::fill(row_.begin(), row_.end(), 0.0F);
    const std::size_t tap = static_cast<std::size_t>(y) * vertical_.count;
    for (int t = 0; t < vertical_.count; ++t) {
      AddRow(image.ptr<std::uint8_t>(vertical_.index[tap + t]) +
                 horizontal_.begin * channels,
             vertical_.weight[tap + t],
             row_values,
             row_.data());
    }
    if (channels == 3) {
      ReduceColourRow(y);
    } else {
      ReduceGrayRow(y);
    }
  }
}

}  // namespace groundlock::target::internal
