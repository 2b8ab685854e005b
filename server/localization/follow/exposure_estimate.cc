// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/exposure_estimate.h"

#include <algorithm>
#include <cstddef>
#include <optional>

namespace groundlock::localization {
namespace {

// Of what a frame said, after the next one that says something.
constexpr double kMemory = 0.95;
// Slower, and a step of exposure changes less than a pixel.
constexpr double kMinSpeed_px_s = 250.0;
constexpr double kMaxKeySpeedShare = 0.5;
// A single patch may be something else.
constexpr std::size_t kMinPatches = 2;
// An exposure that explains hardly more than none does is not believed.
constexpr double kMaxMismatchShare = 0.9;

}  // namespace

bool ExposureEstimate::Tells(const PatchPair& blurs_per_s) {
  const double speed_px_s = blurs_per_s.current_blur.norm();
  return speed_px_s > kMinSpeed_px_s &&
         blurs_per_s.key_blur.norm() < kMaxKeySpeedShare * speed_px_s;
}

double ExposureEstimate::seconds() const {
  const auto least = std::min_element(mismatch_.begin(), mismatch_.end());
  if (*least > kMaxMismatchShare * mismatch_.front()) return 0.0;
  const auto index = static_cast<double>(least - mismatch_.begin());
  if (least == mismatch_.begin() || least + 1 == mismatch_.end()) {
    return index * kStep_s;
  }
  // A parabola through the least and its neighbours.
  const double before = *(least - 1) - *least;
  const double after = *(least + 1) - *least;
  const double sum = before + after;
  const double shift = sum > 0.0 ? 0.5 * (before - after) / sum : 0.0;
  return (index + shift) * kStep_s;
}

void ExposureEstimate::Observe(const cv::Mat& key,
                               const cv::Mat& current,
                               std::span<const MovingPatch> patches) {
  std::array<double, kSteps> sum{};
  std::size_t told = 0;
  for (const MovingPatch& patch : patches) {
    if (!Tells(patch.pair)) continue;
    std::array<double, kSteps> of_patch{};
    bool complete = true;
    for (int i = 0; i < kSteps && complete; ++i) {
      PatchPair pair = patch.pair;
      pair.key_blur *= i * kStep_s;
      pair.current_blur *= i * kStep_s;
      const auto mismatch = PatchMismatch(key, current, pair, patch.point);
      complete = mismatch.has_value();
      of_patch[i] = mismatch.value_or(0.0);
    }
    if (!complete) continue;
    ++told;
    for (int i = 0; i < kSteps; ++i) sum[i] += of_patch[i];
  }
  if (told < kMinPatches) return;
  for (int i = 0; i < kSteps; ++i) {
    mismatch_[i] = kMemory * mismatch_[i] + sum[i] / static_cast<double>(told);
  }
}

}  // namespace groundlock::localization
