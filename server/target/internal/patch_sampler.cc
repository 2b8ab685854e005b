// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/patch_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

constexpr double kWidestKernel = 4.0;  // pixels a cell, beyond it may alias
constexpr int kMostTaps = 16;
constexpr int kMostBlockRows = kMostTaps * kVectorFloats;

// What a vector's worth of rows of the patch read of the image.
struct RowBlock {
  // Where in the image its rows are that any of them reads.
  std::array<const std::uint8_t*, kMostBlockRows> rows;
  int row_count = 0;
  int values = 0;  // of a row
  int taps = 0;    // of a row of the patch
  // Per row of the patch and tap.
  std::array<int, kMostBlockRows> slots;  // in `rows`
  std::array<float, kMostBlockRows> weights;
};

// What the cells of a row read of columns that SumRows made.
struct ColumnTaps {
  int cells = 0;
  int taps = 0;          // of a cell
  const int* offsets;    // per cell and tap
  const float* weights;  // likewise
};

// Without branches, so that the compiler makes vectors of a row of them.
double CubicKernel(double x) {
  x = std::abs(x);
  const double inner = (1.5 * x - 2.5) * x * x + 1.0;
  const double outer = ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0;
  return x < 1.0 ? inner : x < 2.0 ? outer : 0.0;
}

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/patch_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

// Each pixel of `out` is the mean of the middle four of a square of `pitch`
// pixels.
void PatchSampler::HalvePixels(const cv::Mat& image, int pitch, cv::Mat& out) {
  const int channels = image.channels();
  const int values = image.cols * channels;
  means_.resize(values);
  const int before = pitch / 2 - 1;
  for (int y = 0; y < out.rows; ++y) {
    GROUNDLOCK_WIDEST(MeansOfFours)
    (image.ptr<std::uint8_t>(pitch * y + before),
     image.ptr<std::uint8_t>(pitch * y + before + 1),
     values - channels,
     channels,
     means_.data());
    auto* mean = out.ptr<std::uint8_t>(y);
    const std::uint8_t* from =
        &means_[static_cast<std::size_t>(before) * channels];
    if (channels == 1) {
      for (int x = 0; x < out.cols; ++x) mean[x] = from[x * pitch];
      continue;
    }
    // Four values of a pixel's three, of which the next one overwrites the
    // last.
    const int last = 3 * (out.cols - 1);
    for (int at = 0; at < last; at += 3) {
      std::memcpy(mean + at, from + static_cast<std::ptrdiff_t>(at) * pitch, 4);
    }
    std::copy_n(
        from + static_cast<std::ptrdiff_t>(last) * pitch, 3, mean + last);
  }
}

PatchSampler::PatchSampler(int cells) : cells_(cells) {
  const auto most =
      static_cast<std::size_t>(cells * std::ceil(4.0 * kWidestKernel));
  for (Taps* taps : {&horizontal_, &vertical_}) {
    taps->index.reserve(most);
    taps->weight.reserve(most);
  }
  offsets_.reserve(most);
  for (auto& plane : planes_) {
    plane.resize(static_cast<std::size_t>(cells_) * cells_);
  }
}

geometry::Box2 ReachOf(const geometry::Box2& box_px, int cells) {
  // Twice the kernel's width, which is a cell or a pixel, and what rounding to
  // whole pixels of a halved image adds.
  const Eigen::Vector2d reach_px =
      3.0 * (box_px.size_px() / cells).cwiseMax(1.0) +
      Eigen::Vector2d::Constant(1.0);
  return {box_px.min_px - reach_px, box_px.max_px + reach_px};
}

int PatchSampler::Halvings(const Eigen::Vector2d& size_px) const {
  // The mean of four is a worse filter than the kernel, which has more pixels
  // to go by if so many a cell are left.
  constexpr double kLeft = 1.25;
  const double step = size_px.minCoeff() / (kLeft * cells_);
  return step >= 2.0 ? static_cast<int>(std::min(std::log2(step), 30.0)) : 0;
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
    std::array<double, kMostTaps> kernel;
    for (int t = 0; t < taps.count; ++t) {
      kernel[t] = CubicKernel((first + t - center) / width);
    }
    double sum = 0.0;
    for (int t = 0; t < taps.count; ++t) sum += kernel[t];
    for (int t = 0; t < taps.count; ++t) {
      index[t] = std::clamp(first + t, 0, image_px - 1);
      weight[t] = static_cast<float>(kernel[t] / sum);
    }
    taps.begin = std::min(taps.begin, index[0]);
    taps.end = std::max(taps.end, index[taps.count - 1] + 1);
  }
}

void PatchSampler::Sample(const cv::Mat& image, const geometry::Box2& box_px) {
  const double least = std::min(image.cols, image.rows);
  const int halvings =
      std::min(Halvings(box_px.size_px()), static_cast<int>(std::log2(least)));
  if (halvings == 0) {
    SampleHalved(image, box_px);
    return;
  }
  const double scale = std::ldexp(1.0, -halvings);
  const geometry::Box2 small_px{scale * box_px.min_px, scale * box_px.max_px};
  const geometry::Box2 reach_px = ReachOf(small_px, cells_);
  // What is read of the image, in pixels of the halved one. At least one pixel:
  // outside, the edge is repeated.
  const auto range = [](double first, double end, int size) {
    const int begin = static_cast<int>(std::clamp(first, 0.0, size - 1.0));
    return cv::Range(
        begin,
        static_cast<int>(std::clamp(std::ceil(end), begin + 1.0, 1.0 * size)));
  };
  const cv::Range columns =
      range(reach_px.min_px.x(), reach_px.max_px.x(), image.cols >> halvings);
  const cv::Range rows =
      range(reach_px.min_px.y(), reach_px.max_px.y(), image.rows >> halvings);
  // Of four pixels a cell and more, the first halving takes every second pair:
  // it reads so much at most, whatever the box.
  int pitch = 1 << std::max(1, halvings - 1);
  cv::Mat half =
      image(cv::Range(rows.start << halvings, rows.end << halvings),
            cv::Range(columns.start << halvings, columns.end << halvings));
  for (int left = half.rows / rows.size(), i = 0; left > 1; ++i) {
    std::vector<std::uint8_t>& pixels = halves_[i % 2];
    const cv::Size size(half.cols / pitch, half.rows / pitch);
    pixels.resize(static_cast<std::size_t>(size.area()) * half.channels());
    cv::Mat out(size, half.type(), pixels.data());
    HalvePixels(half, pitch, out);
    half = out;
    left /= pitch;
    pitch = 2;
  }
  const Eigen::Vector2d origin_px(columns.start, rows.start);
  SampleHalved(half,
               {small_px.min_px - origin_px, small_px.max_px - origin_px});
}

// Rows first, then columns.
void PatchSampler::SampleRows(const cv::Mat& image, int y) {
  const int channels = image.channels();
  RowBlock block;
  block.values = (horizontal_.end - horizontal_.begin) * channels;
  block.taps = vertical_.count;
  int last = -1;  // row of the image
  for (int k = 0; k < kVectorFloats; ++k) {
    const std::size_t from =
        static_cast<std::size_t>(std::min(y + k, cells_ - 1)) * block.taps;
    for (int t = 0; t < block.taps; ++t) {
      const int at = vertical_.index[from + t];
      // In order, and without gaps where rows overlap.
      if (at > last) {
        last = at;
        block.rows[block.row_count++] =
            image.ptr<std::uint8_t>(at) + horizontal_.begin * channels;
      }
      block.slots[k * block.taps + t] = block.row_count - 1 - (last - at);
      block.weights[k * block.taps + t] = vertical_.weight[from + t];
    }
  }
  GROUNDLOCK_WIDEST(SumRows)(block, columns_.data());

  const ColumnTaps taps{
      cells_, horizontal_.count, offsets_.data(), horizontal_.weight.data()};
  const std::size_t first = static_cast<std::size_t>(y) * cells_;
  const std::array<float*, 3> planes = {
      &planes_[0][first], &planes_[1][first], &planes_[2][first]};
  const int height = std::min(kVectorFloats, cells_ - y);
  (channels == 3 ? GROUNDLOCK_WIDEST(SumColourColumns)
                 : GROUNDLOCK_WIDEST(SumGrayColumns))(
      taps, columns_.data(), height, planes.data());
}

void PatchSampler::SampleHalved(const cv::Mat& image,
                                const geometry::Box2& box_px) {
  FillTaps(box_px.x(), box_px.width(), image.cols, horizontal_);
  FillTaps(box_px.y(), box_px.height(), image.rows, vertical_);
  const int channels = image.channels();
  offsets_.resize(horizontal_.index.size());
  for (std::size_t i = 0; i < offsets_.size(); ++i) {
    offsets_[i] =
        (horizontal_.index[i] - horizontal_.begin) * channels * kVectorFloats;
  }
  // Whole rows fit, so that a box that grows asks for nothing more.
  const auto values = [channels](int pixels) {
    return static_cast<std::size_t>(WholeVectors(pixels * channels)) *
           kVectorFloats;
  };
  columns_.reserve(values(image.cols));
  columns_.resize(values(horizontal_.end - horizontal_.begin));
  for (int y = 0; y < cells_; y += kVectorFloats) SampleRows(image, y);
}

}  // namespace groundlock::target::internal
