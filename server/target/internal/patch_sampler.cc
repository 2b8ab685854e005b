// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/patch_sampler.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core/hal/intrin.hpp>

namespace groundlock::target::internal {
namespace {

constexpr double kWidestKernel = 4.0;  // pixels a cell, beyond it may alias
constexpr int kRowStep = 16;           // rows are padded to whole multiples

int Padded(int values) { return (values + kRowStep - 1) / kRowStep * kRowStep; }

double CubicKernel(double x) {
  x = std::abs(x);
  if (x < 1.0) return (1.5 * x - 2.5) * x * x + 1.0;
  if (x < 2.0) return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0;
  return 0.0;
}

// Each pixel of `out` is the mean of the middle four of a square of `pitch`
// pixels.
void HalvePixels(const cv::Mat& image,
                 int pitch,
                 std::vector<std::uint16_t>& pair,
                 cv::Mat& out) {
  const int channels = image.channels();
  const int values = image.cols * channels;
  pair.resize(values);
  std::uint16_t* __restrict sum = pair.data();
  const int before = pitch / 2 - 1;
  for (int y = 0; y < out.rows; ++y) {
    const auto* __restrict upper = image.ptr<std::uint8_t>(pitch * y + before);
    const auto* __restrict lower =
        image.ptr<std::uint8_t>(pitch * y + before + 1);
    for (int i = 0; i < values; ++i) {
      sum[i] = static_cast<std::uint16_t>(upper[i] + lower[i]);
    }
    auto* __restrict mean = out.ptr<std::uint8_t>(y);
    const std::uint16_t* __restrict left = sum + before * channels;
    for (int x = 0; x < out.cols; ++x) {
      for (int c = 0; c < channels; ++c) {
        *mean++ =
            static_cast<std::uint8_t>((left[c] + left[channels + c] + 2) / 4);
      }
      left += pitch * channels;
    }
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

// A pixel and the next one's first value make a vector. Cells go together by
// four, so that no sum waits for itself.
void PatchSampler::ReduceColourRow(int y) {
  constexpr int kTogether = 4;
  const int count = horizontal_.count;
  const cv::v_float32x4 darkest = cv::v_setzero_f32();
  const cv::v_float32x4 brightest = cv::v_setall_f32(255.0F);
  for (int first = 0; first < cells_; first += kTogether) {
    // The last ones are some of those before, again.
    const int x = std::max(0, std::min(first, cells_ - kTogether));
    std::array<cv::v_float32x4, kTogether> sum;
    sum.fill(cv::v_setzero_f32());
    std::array<const int*, kTogether> index;
    std::array<const float*, kTogether> weight;
    for (int k = 0; k < kTogether; ++k) {
      const int at = std::min(x + k, cells_ - 1) * count;
      index[k] = &horizontal_.index[at];
      weight[k] = &horizontal_.weight[at];
    }
    for (int t = 0; t < count; ++t) {
      for (int k = 0; k < kTogether; ++k) {
        sum[k] += cv::v_setall_f32(weight[k][t]) *
                  cv::v_load(&row_[3 * (index[k][t] - horizontal_.begin)]);
      }
    }
    std::array<cv::v_float32x4, kTogether> colour;
    cv::v_transpose4x4(sum[0],
                       sum[1],
                       sum[2],
                       sum[3],
                       colour[0],
                       colour[1],
                       colour[2],
                       colour[3]);
    for (int c = 0; c < 3; ++c) {
      const cv::v_float32x4 value =
          cv::v_min(cv::v_max(colour[c], darkest), brightest);
      float* out = &planes_[c][static_cast<std::size_t>(y) * cells_ + x];
      if (cells_ >= kTogether) {
        cv::v_store(out, value);
      } else {
        std::array<float, kTogether> few;
        cv::v_store(few.data(), value);
        std::copy_n(few.begin(), cells_, out);
      }
    }
  }
}

void PatchSampler::ReduceRows(const cv::Mat& image, int y) {
  const int channels = image.channels();
  const int values = (horizontal_.end - horizontal_.begin) * channels;
  const std::size_t pitch = Padded(values);
  const std::size_t tap = static_cast<std::size_t>(y) * vertical_.count;
  std::array<const float*, kMostTaps> rows;
  for (int t = 0; t < vertical_.count; ++t) {
    const int at = vertical_.index[tap + t];
    const int slot = at % kMostTaps;
    float* row = &rows_[slot * pitch];
    rows[t] = row;
    if (row_at_[slot] == at) continue;
    row_at_[slot] = at;
    const auto* pixels =
        image.ptr<std::uint8_t>(at) + horizontal_.begin * channels;
    for (int i = 0; i < values; ++i) row[i] = static_cast<float>(pixels[i]);
  }
  const float* weight = &vertical_.weight[tap];
  for (std::size_t i = 0; i < pitch; i += kRowStep) {
    std::array<cv::v_float32x4, kRowStep / 4> sum;
    sum.fill(cv::v_setzero_f32());
    for (int t = 0; t < vertical_.count; ++t) {
      const cv::v_float32x4 w = cv::v_setall_f32(weight[t]);
      for (int k = 0; k < kRowStep / 4; ++k) {
        sum[k] += w * cv::v_load(rows[t] + i + 4 * k);
      }
    }
    for (int k = 0; k < kRowStep / 4; ++k) {
      cv::v_store(row_.data() + i + 4 * k, sum[k]);
    }
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
    HalvePixels(half, pitch, pair_, out);
    half = out;
    left /= pitch;
    pitch = 2;
  }
  const Eigen::Vector2d origin_px(columns.start, rows.start);
  SampleHalved(half,
               {small_px.min_px - origin_px, small_px.max_px - origin_px});
}

void PatchSampler::SampleHalved(const cv::Mat& image,
                                const geometry::Box2& box_px) {
  FillTaps(box_px.x(), box_px.width(), image.cols, horizontal_);
  FillTaps(box_px.y(), box_px.height(), image.rows, vertical_);
  const int channels = image.channels();
  // Whole rows fit, so that a box that grows asks for nothing more;
  // ReduceColourRow reads one value more.
  const auto row_values = static_cast<std::size_t>(
      Padded((horizontal_.end - horizontal_.begin) * channels));
  const auto most = static_cast<std::size_t>(Padded(image.cols * channels));
  row_.reserve(most + 1);
  rows_.reserve(most * kMostTaps);
  row_.resize(row_values + 1);
  rows_.resize(row_values * kMostTaps);
  row_at_.fill(-1);
  for (int y = 0; y < cells_; ++y) {
    ReduceRows(image, y);
    if (channels == 3) {
      ReduceColourRow(y);
    } else {
      ReduceGrayRow(y);
    }
  }
}

}  // namespace groundlock::target::internal
