// SPDX-License-Identifier: Apache-2.0
// Many Fourier transforms of one size at once.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_

#include <array>
#include <vector>

namespace groundlock::target::internal {

// Transforms kLanes lines of complex numbers together: a cell is kLanes real
// parts, then kLanes imaginary parts, one cache line; every step of the
// transform does the same to all lanes, by the machine's vectors. That is
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
  // Of `in`, size() cells that lie `in_pitch` floats apart, to `out`, which may
  // be `in`. The way back is not scaled: there and back is size() times as
  // much.
  void Forward(const float* in, int in_pitch, float* out, int out_pitch) {
    Transform({in, in_pitch, 0, kLanes}, out, out_pitch);
  }
  void Inverse(const float* in, int in_pitch, float* out, int out_pitch) {
    Transform({in, in_pitch, kLanes, 0}, out, out_pitch);
  }

  // What a step of a transform reads; `re` and `im` are where in a cell the
  // parts lie. Exchanging them turns the forward transform into the inverse.
  struct Input {
    const float* cells;
    int pitch;
    int re, im;
  };
  struct Step {
    int radix;
    int groups;  // p = 0 .. groups - 1
    int stride;
    std::vector<float> twiddle;  // (cos, sin) of each p and j = 1 .. radix - 1
  };

 private:
  void Transform(Input in, float* out, int out_pitch);

  int size_;
  std::vector<Step> steps_;
  std::array<std::vector<float>, 2> scratch_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_LANE_TRANSFORM_H_
