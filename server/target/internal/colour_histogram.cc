// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/colour_histogram.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace groundlock::target::internal {
namespace {

// The corners of a box are seldom the target's: only its inner part is learnt.
constexpr double kInnerShare = 0.8;
// Of either histogram, spread over all colours: a colour never seen says 1/2.
constexpr float kUnseen = 1e-4F;

}  // namespace

ColourHistogram::ColourHistogram(int side)
    : side_(side),
      grid_(side / kStep),
      target_(kBins),
      around_(kBins),
      target_now_(kBins),
      around_now_(kBins),
      probability_(kBins, 0.5F),
      integral_(static_cast<std::size_t>(grid_ + 1) * (grid_ + 1)) {}

int ColourHistogram::Bin(const PatchSampler& sampler, std::size_t at) {
  int bin = 0;
  for (int c = 0; c < 3; ++c) {
    const auto value = static_cast<std::uint8_t>(sampler.plane(c)[at]);
    bin = (bin << kBits) | (value >> (8 - kBits));
  }
  return bin;
}

void ColourHistogram::Learn(const PatchSampler& sampler,
                            const Eigen::Vector2d& target_samples,
                            double rate) {
  std::fill(target_now_.begin(), target_now_.end(), 0.0F);
  std::fill(around_now_.begin(), around_now_.end(), 0.0F);
  const Eigen::Vector2d outer = 0.5 * target_samples;
  const Eigen::Vector2d inner = kInnerShare * outer;
  const double center = 0.5 * (side_ - 1);
  float target_count = 0.0F;
  float around_count = 0.0F;
  for (int y = 0; y < side_; y += kStep) {
    const double dy = std::abs(y - center);
    for (int x = 0; x < side_; x += kStep) {
      const double dx = std::abs(x - center);
      const int bin = Bin(sampler, static_cast<std::size_t>(y) * side_ + x);
      if (dx <= inner.x() && dy <= inner.y()) {
        target_now_[bin] += 1.0F;
        target_count += 1.0F;
      } else if (dx > outer.x() || dy > outer.y()) {
        around_now_[bin] += 1.0F;
        around_count += 1.0F;
      }
    }
  }
  const auto r = static_cast<float>(rate);
  const float target_share = r / std::max(1.0F, target_count);
  const float around_share = r / std::max(1.0F, around_count);
  expected_ = expected_around_ = 0.0;
  for (int bin = 0; bin < kBins; ++bin) {
    target_[bin] = (1.0F - r) * target_[bin] + target_share * target_now_[bin];
    around_[bin] = (1.0F - r) * around_[bin] + around_share * around_now_[bin];
    probability_[bin] = (target_[bin] + kUnseen) /
                        (target_[bin] + around_[bin] + 2.0F * kUnseen);
    expected_ += target_[bin] * probability_[bin];
    expected_around_ += around_[bin] * probability_[bin];
  }
}

void ColourHistogram::Look(const PatchSampler& sampler) {
  const int pitch = grid_ + 1;
  for (int y = 0; y < grid_; ++y) {
    float row = 0.0F;
    for (int x = 0; x < grid_; ++x) {
      row += probability_[Bin(
          sampler, static_cast<std::size_t>(y) * kStep * side_ + x * kStep)];
      integral_[(y + 1) * pitch + x + 1] = integral_[y * pitch + x + 1] + row;
    }
  }
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
