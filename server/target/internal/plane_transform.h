// SPDX-License-Identifier: Apache-2.0
// One real square from half of its spectrum.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_PLANE_TRANSFORM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_PLANE_TRANSFORM_H_

#include <complex>
#include <vector>

#include "server/target/internal/lane_transform.h"

namespace groundlock::target::internal {

// Transforms a square back by LaneTransform: neighbouring columns are the lanes
// first, then neighbouring rows. Keeps its buffers. Not thread-safe.
class PlaneTransform {
 public:
  // As LaneTransform's.
  explicit PlaneTransform(int size);

  // Sets frequency (x, y), 0 <= x <= size / 2, and its mirror.
  void Put(int x, int y, const std::complex<float>& value) {
    *At(x, y) = value.real();
    *(At(x, y) + LaneTransform::kLanes) = value.imag();
    const int mirror_x = (size_ - x) % size_;
    const int mirror_y = (size_ - y) % size_;
    *At(mirror_x, mirror_y) = value.real();
    *(At(mirror_x, mirror_y) + LaneTransform::kLanes) = -value.imag();
  }
  // Transforms what was put, once all is, to size x size numbers `scale` times
  // as large. What was put is lost.
  void Inverse(float scale, float* out);

 private:
  float* At(int x, int y) {
    return &columns_[static_cast<std::size_t>(
                         x / LaneTransform::kLanes * size_ + y) *
                         LaneTransform::kCellFloats +
                     x % LaneTransform::kLanes];
  }

  int size_;
  LaneTransform transform_;
  // Lines of `size` cells, one for each kLanes columns or rows.
  std::vector<float> columns_, rows_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_PLANE_TRANSFORM_H_
