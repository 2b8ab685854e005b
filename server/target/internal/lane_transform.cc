// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/lane_transform.h"

#include <cmath>
#include <cstddef>
#include <numbers>
#include <utility>

#include "server/target/internal/vectors.h"

static_assert(groundlock::target::internal::LaneTransform::kLanes ==
              groundlock::target::internal::kVectorFloats);

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/lane_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

LaneTransform::LaneTransform(int size) : size_(size) {
  int left = size;
  int stride = 1;
  while (left > 1) {
    const int radix = left % 4 == 0 ? 4 : left % 3 == 0 ? 3 : 2;
    Step step{radix, left / radix, stride, {}};
    for (int p = 0; p < step.groups; ++p) {
      for (int j = 1; j < radix; ++j) {
        const double angle = -2.0 * std::numbers::pi * p * j / left;
        step.twiddle.push_back(static_cast<float>(std::cos(angle)));
        step.twiddle.push_back(static_cast<float>(std::sin(angle)));
      }
    }
    left = step.groups;
    stride *= radix;
    steps_.push_back(std::move(step));
  }
  for (auto& scratch : scratch_) {
    scratch.resize(static_cast<std::size_t>(size) * kCellFloats);
  }
}

void LaneTransform::Transform(Input in, float* out, int out_pitch) {
  for (std::size_t i = 0; i + 1 < steps_.size(); ++i) {
    float* scratch = scratch_[i % 2].data();
    GROUNDLOCK_WIDEST(TransformStep)(steps_[i], in, scratch, kCellFloats);
    in.cells = scratch;
    in.pitch = kCellFloats;
  }
  GROUNDLOCK_WIDEST(TransformStep)(steps_.back(), in, out, out_pitch);
}

}  // namespace groundlock::target::internal
