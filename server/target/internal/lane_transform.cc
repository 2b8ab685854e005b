// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/lane_transform.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;

// One butterfly: where its inputs and outputs lie, and its twiddle factors.
// `re` and `im` are the offsets of the parts in a cell; swapping them turns the
// forward transform into the inverse.
struct Butterfly {
  const float* in;
  int in_pitch;
  float* out;
  int out_pitch;
  const float* twiddle;
  int re, im;
};

void Radix2(const Butterfly& b) {
  const float* __restrict x0 = b.in;
  const float* __restrict x1 = b.in + b.in_pitch;
  float* __restrict y0 = b.out;
  float* __restrict y1 = b.out + b.out_pitch;
  const float c = b.twiddle[0];
  const float s = b.twiddle[1];
  for (int i = 0; i < kLanes; ++i) {
    const float r0 = x0[b.re + i];
    const float i0 = x0[b.im + i];
    const float r1 = x1[b.re + i];
    const float i1 = x1[b.im + i];
    const float dr = r0 - r1;
    const float di = i0 - i1;
    y0[b.re + i] = r0 + r1;
    y0[b.im + i] = i0 + i1;
    y1[b.re + i] = dr * c - di * s;
    y1[b.im + i] = dr * s + di * c;
  }
}

void Radix3(const Butterfly& b) {
  constexpr float kSin = std::numbers::sqrt3_v<float> / 2.0F;
  const float* __restrict x0 = b.in;
  const float* __restrict x1 = b.in + b.in_pitch;
  const float* __restrict x2 = b.in + 2 * b.in_pitch;
  float* __restrict y0 = b.out;
  float* __restrict y1 = b.out + b.out_pitch;
  float* __restrict y2 = b.out + 2 * b.out_pitch;
  const float c1 = b.twiddle[0];
  const float s1 = b.twiddle[1];
  const float c2 = b.twiddle[2];
  const float s2 = b.twiddle[3];
  for (int i = 0; i < kLanes; ++i) {
    const float sr = x1[b.re + i] + x2[b.re + i];
    const float si = x1[b.im + i] + x2[b.im + i];
    const float dr = kSin * (x1[b.re + i] - x2[b.re + i]);
    const float di = kSin * (x1[b.im + i] - x2[b.im + i]);
    const float mr = x0[b.re + i] - 0.5F * sr;
    const float mi = x0[b.im + i] - 0.5F * si;
    y0[b.re + i] = x0[b.re + i] + sr;
    y0[b.im + i] = x0[b.im + i] + si;
    const float r1 = mr + di;
    const float i1 = mi - dr;
    const float r2 = mr - di;
    const float i2 = mi + dr;
    y1[b.re + i] = r1 * c1 - i1 * s1;
    y1[b.im + i] = r1 * s1 + i1 * c1;
    y2[b.re + i] = r2 * c2 - i2 * s2;
    y2[b.im + i] = r2 * s2 + i2 * c2;
  }
}

void Radix4(const Butterfly& b) {
  const float* __restrict x0 = b.in;
  const float* __restrict x1 = b.in + b.in_pitch;
  const float* __restrict x2 = b.in + 2 * b.in_pitch;
  const float* __restrict x3 = b.in + 3 * b.in_pitch;
  float* __restrict y0 = b.out;
  float* __restrict y1 = b.out + b.out_pitch;
  float* __restrict y2 = b.out + 2 * b.out_pitch;
  float* __restrict y3 = b.out + 3 * b.out_pitch;
  const float* w = b.twiddle;
  for (int i = 0; i < kLanes; ++i) {
    const float ar = x0[b.re + i] + x2[b.re + i];
    const float ai = x0[b.im + i] + x2[b.im + i];
    const float br = x0[b.re + i] - x2[b.re + i];
    const float bi = x0[b.im + i] - x2[b.im + i];
    const float cr = x1[b.re + i] + x3[b.re + i];
    const float ci = x1[b.im + i] + x3[b.im + i];
    const float dr = x1[b.re + i] - x3[b.re + i];
    const float di = x1[b.im + i] - x3[b.im + i];
    y0[b.re + i] = ar + cr;
    y0[b.im + i] = ai + ci;
    const float r1 = br + di;
    const float i1 = bi - dr;
    const float r2 = ar - cr;
    const float i2 = ai - ci;
    const float r3 = br - di;
    const float i3 = bi + dr;
    y1[b.re + i] = r1 * w[0] - i1 * w[1];
    y1[b.im + i] = r1 * w[1] + i1 * w[0];
    y2[b.re + i] = r2 * w[2] - i2 * w[3];
    y2[b.im + i] = r2 * w[3] + i2 * w[2];
    y3[b.re + i] = r3 * w[4] - i3 * w[5];
    y3[b.im + i] = r3 * w[5] + i3 * w[4];
  }
}

}  // namespace

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

void LaneTransform::Line(float* cells, int pitch, int re, int im) {
  const float* in = cells;
  int in_pitch = pitch;
  for (std::size_t i = 0; i < steps_.size(); ++i) {
    const Step& step = steps_[i];
    const bool last = i + 1 == steps_.size();
    float* out = last ? cells : scratch_[i % 2].data();
    const int out_pitch = last ? pitch : kCellFloats;
    const float* twiddle = step.twiddle.data();
    for (int p = 0; p < step.groups; ++p) {
      for (int q = 0; q < step.stride; ++q) {
        const Butterfly butterfly{
            in + (q + step.stride * p) * in_pitch,
            step.stride * step.groups * in_pitch,
            out + (q + step.stride * step.radix * p) * out_pitch,
            step.stride * out_pitch,
            twiddle,
            re,
            im};
        switch (step.radix) {
          case 4:
            Radix4(butterfly);
            break;
          case 3:
            Radix3(butterfly);
            break;
          default:
            Radix2(butterfly);
        }
      }
      twiddle += 2 * (step.radix - 1);
    }
    in = out;
    in_pitch = out_pitch;
  }
}

void LaneTransform::Forward(float* cells, int first_row, int end_row) {
  const int row_floats = size_ * kCellFloats;
  std::fill(cells, cells + first_row * row_floats, 0.0F);
  std::fill(cells + end_row * row_floats, cells + size_ * row_floats, 0.0F);
  for (int y = first_row; y < end_row; ++y) {
    Line(cells + y * row_floats, kCellFloats, 0, kLanes);
  }
  for (int x = 0; x < size_; ++x) {
    Line(cells + x * kCellFloats, row_floats, 0, kLanes);
  }
}

void LaneTransform::Inverse(float* cells, int first_row, int end_row) {
  const int row_floats = size_ * kCellFloats;
  for (int x = 0; x < size_; ++x) {
    Line(cells + x * kCellFloats, row_floats, kLanes, 0);
  }
  for (int y = first_row; y < end_row; ++y) {
    Line(cells + y * row_floats, kCellFloats, kLanes, 0);
  }
}

}  // namespace groundlock::target::internal
