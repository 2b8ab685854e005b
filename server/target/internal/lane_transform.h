// SPDX-License-Identifier: Apache-2.0
// Many two-dimensional Fourier transforms of one size at once.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_

#include <vector>

namespace groundlock::target::internal {

// Transforms kLanes complex squares together: a cell is kLanes real parts, then
// kLanes imaginary parts, one cache line; every step of the transform does the
// same to all lanes, which the compiler turns into vector instructions. That is
// several times faster than as many transforms of interleaved numbers.
//
// Radix 4, 3 and 2 autosort steps (C. Van Loan, "Computational frameworks for
// the fast Fourier transform", 1992, section 1.7). Not thread-safe.
class LaneTransform {
 public:
  static constexpr int kLanes = 8;
  static constexpr int kCellFloats = 2 * kLanes;

  // `size` = 2^a 3^b >= 6.
  explicit LaneTransform(int size);

  int size() const { return size_; }
  // In place; size x size cells, row by row; not scaled. Rows outside
  // [first_row, end_row) are taken to be zero, whatever they hold.
  void Forward(float* cells, int first_row, int end_row);
  // Only rows [first_row, end_row) of the result are right, and all of them
  // size^2 times too large.
  void Inverse(float* cells, int first_row, int end_row);

 private:
  struct Step {
    int radix;
    int groups;  // p = 0 .. groups - 1
    int stride;
    std::vector<float> twiddle;  // (cos, sin) of each p and j = 1 .. radix - 1
  };
  // One row or column of `size_` cells that lie `pitch` floats apart.
  void Line(float* cells, int pitch, int re, int im);

  int size_;
  std::vector<Step> steps_;
  std::vector<float> scratch_[2];
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_
