// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/plane_transform.h"

#include <algorithm>
#include <cstddef>

#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;
constexpr int kCellFloats = LaneTransform::kCellFloats;

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/plane_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

PlaneTransform::PlaneTransform(int size)
    : size_(size),
      transform_(size),
      columns_(static_cast<std::size_t>(WholeVectors(size)) / kLanes * size *
               kCellFloats),
      rows_(columns_.size()) {}

void PlaneTransform::Inverse(float scale, float* out) {
  const std::size_t line = static_cast<std::size_t>(size_) * kCellFloats;
  for (std::size_t at = 0; at < columns_.size(); at += line) {
    transform_.Inverse(&columns_[at], kCellFloats, &columns_[at], kCellFloats);
  }
  GROUNDLOCK_WIDEST(RowsOfColumns)(size_, columns_.data(), rows_.data());
  for (std::size_t at = 0; at < rows_.size(); at += line) {
    transform_.Inverse(&rows_[at], kCellFloats, &rows_[at], kCellFloats);
  }
  GROUNDLOCK_WIDEST(PutRows)(size_, rows_.data(), scale, out);
}

}  // namespace groundlock::target::internal
