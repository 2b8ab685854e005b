// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/colour_histogram.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>

#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

// The corners of a box are seldom the target's: only its inner part is learnt.
constexpr double kInnerShare = 0.8;
// Of either histogram, spread over all colours: a colour never seen says 1/2.
constexpr float kUnseen = 1e-4F;

// A single sample's log-likelihood ratio: histograms are not known better.
constexpr float kMostEvidence = 2.0F;

constexpr int kBits = 4;  // of a colour's component, that make its bin

struct Mix {
  float keep, target_share, around_share;
  const float *target_now, *around_now;
  float *target, *around, *probability;
};

// Of the samples along an axis that are looked at, those so far from the
// middle at most: [first, end).
struct Span {
  int first, end;
};

Span SpanWithin(double reach, int side, int step) {
  const double center = 0.5 * (side - 1);
  Span span{0, 0};
  for (int i = 0; i < side; i += step) {
    if (std::abs(i - center) > reach) continue;
    if (span.end == 0) span.first = i / step;
    span.end = i / step + 1;
  }
  return span;
}

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/colour_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

ColourHistogram::ColourHistogram(int side)
    : side_(side),
      grid_(side / kStep),
      bins_(side),
      target_(kBins),
      around_(kBins),
      target_now_(kBins),
      around_now_(kBins),
      probability_(kBins, 0.5F),
      integral_(static_cast<std::size_t>(grid_ + 1) * (grid_ + 1)),
      evidence_(kBins),
      evidence_integral_(integral_.size()) {}

const std::int32_t* ColourHistogram::RowBins(const PatchSampler& sampler,
                                             int y) {
  const std::size_t first = static_cast<std::size_t>(y) * side_;
  const std::array<const float*, 3> planes = {&sampler.plane(0)[first],
                                              &sampler.plane(1)[first],
                                              &sampler.plane(2)[first]};
  GROUNDLOCK_WIDEST(ColourBins)(planes.data(), side_, bins_.data());
  return bins_.data();
}

void ColourHistogram::Learn(const PatchSampler& sampler,
                            const Eigen::Vector2d& target_samples,
                            double rate) {
  std::fill(target_now_.begin(), target_now_.end(), 0.0F);
  std::fill(around_now_.begin(), around_now_.end(), 0.0F);
  const Eigen::Vector2d outer = 0.5 * target_samples;
  const Eigen::Vector2d inner = kInnerShare * outer;
  const Span inner_x = SpanWithin(inner.x(), side_, kStep);
  const Span inner_y = SpanWithin(inner.y(), side_, kStep);
  const Span outer_x = SpanWithin(outer.x(), side_, kStep);
  const Span outer_y = SpanWithin(outer.y(), side_, kStep);
  int target_count = 0;
  int around_count = 0;
  for (int y = 0; y < grid_; ++y) {
    const std::int32_t* bins = RowBins(sampler, y * kStep);
    const auto count = [bins](int first, int end, Counts& counts) {
      for (int x = first; x < end; ++x) counts[bins[x * kStep]] += 1.0F;
      return std::max(0, end - first);
    };
    if (y >= inner_y.first && y < inner_y.end) {
      target_count += count(inner_x.first, inner_x.end, target_now_);
    }
    const bool outside = y < outer_y.first || y >= outer_y.end;
    around_count += count(0, outside ? grid_ : outer_x.first, around_now_);
    if (!outside) around_count += count(outer_x.end, grid_, around_now_);
  }
  const auto r = static_cast<float>(rate);
  GROUNDLOCK_WIDEST(MixCounts)
  ({.keep = 1.0F - r,
    .target_share = r / static_cast<float>(std::max(1, target_count)),
    .around_share = r / static_cast<float>(std::max(1, around_count)),
    .target_now = target_now_.data(),
    .around_now = around_now_.data(),
    .target = target_.data(),
    .around = around_.data(),
    .probability = probability_.data()},
   kBins);
  expected_ = expected_around_ = 0.0;
  for (int bin = 0; bin < kBins; ++bin) {
    expected_ += target_[bin] * probability_[bin];
    expected_around_ += around_[bin] * probability_[bin];
  }
}

void ColourHistogram::Look(const PatchSampler& sampler) {
  const int pitch = grid_ + 1;
  for (int y = 0; y < grid_; ++y) {
    const std::int32_t* bins = RowBins(sampler, y * kStep);
    float row = 0.0F;
    for (int x = 0; x < grid_; ++x) {
      row += probability_[bins[x * kStep]];
      integral_[(y + 1) * pitch + x + 1] = integral_[y * pitch + x + 1] + row;
    }
  }
}

void ColourHistogram::LookForBoxes(const PatchSampler& sampler) {
  for (int bin = 0; bin < kBins; ++bin) {
    evidence_[bin] = std::clamp(
        std::log((target_[bin] + kUnseen) / (around_[bin] + kUnseen)),
        -kMostEvidence,
        kMostEvidence);
  }
  const int pitch = grid_ + 1;
  for (int y = 0; y < grid_; ++y) {
    const std::int32_t* bins = RowBins(sampler, y * kStep);
    float row = 0.0F;
    for (int x = 0; x < grid_; ++x) {
      row += evidence_[bins[x * kStep]];
      evidence_integral_[(y + 1) * pitch + x + 1] =
          evidence_integral_[y * pitch + x + 1] + row;
    }
  }
}

double ColourHistogram::BoxEvidence(const geometry::Box2& box_samples) const {
  const int pitch = grid_ + 1;
  // From the patch's corner to there, samples divided as the box divides them.
  const auto up_to = [&](double x_samples, double y_samples) {
    const double x = std::clamp(x_samples / kStep, 0.0, 1.0 * grid_);
    const double y = std::clamp(y_samples / kStep, 0.0, 1.0 * grid_);
    const int column = std::min(static_cast<int>(x), grid_ - 1);
    const int row = std::min(static_cast<int>(y), grid_ - 1);
    const double of_column = x - column;
    const double of_row = y - row;
    const float* corner = &evidence_integral_[row * pitch + column];
    const double above = (1.0 - of_column) * corner[0] + of_column * corner[1];
    const double below =
        (1.0 - of_column) * corner[pitch] + of_column * corner[pitch + 1];
    return (1.0 - of_row) * above + of_row * below;
  };
  const Eigen::Vector2d& least = box_samples.min_px;
  const Eigen::Vector2d& most = box_samples.max_px;
  return up_to(most.x(), most.y()) - up_to(least.x(), most.y()) -
         up_to(most.x(), least.y()) + up_to(least.x(), least.y());
}

cv::Mat ColourHistogram::Probability(const cv::Mat& bgr) const {
  constexpr int kShift = 8 - kBits;
  cv::Mat probability(bgr.size(), CV_32F);
  for (int y = 0; y < bgr.rows; ++y) {
    const auto* pixel = bgr.ptr<cv::Vec3b>(y);
    auto* told = probability.ptr<float>(y);
    for (int x = 0; x < bgr.cols; ++x) {
      const int bin =
          (((pixel[x][0] >> kShift) << kBits | (pixel[x][1] >> kShift))
           << kBits) |
          (pixel[x][2] >> kShift);
      told[x] = probability_[bin];
    }
  }
  return probability;
}

double ColourHistogram::Likelihood(
    const Eigen::Vector2d& shift_samples,
    const Eigen::Vector2d& target_samples) const {
  const Eigen::Vector2d center = (shift_samples.array() + 0.5 * side_) / kStep;
  const Eigen::Vector2d half = (0.5 * kInnerShare / kStep) * target_samples;
  const auto bound = [this](double at) {
    return static_cast<int>(
        std::lround(std::clamp(at, 0.0, static_cast<double>(grid_))));
  };
  const int left = bound(center.x() - half.x());
  const int right = bound(center.x() + half.x());
  const int top = bound(center.y() - half.y());
  const int bottom = bound(center.y() + half.y());
  const int count = (right - left) * (bottom - top);
  if (count <= 0) return 0.0;
  const int pitch = grid_ + 1;
  const double sum = static_cast<double>(integral_[bottom * pitch + right]) -
                     integral_[top * pitch + right] -
                     integral_[bottom * pitch + left] +
                     integral_[top * pitch + left];
  return std::clamp(sum / count, 0.0, 1.0);
}

}  // namespace groundlock::target::internal
