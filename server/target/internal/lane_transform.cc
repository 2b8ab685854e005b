// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/lane_transform.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/core/hal/intrin.hpp>

namespace groundlock::target::internal {
namespace {

using Vector = cv::v_float32x4;

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
  const Vector c = cv::v_setall_f32(b.twiddle[0]);
  const Vector s = cv::v_setall_f32(b.twiddle[1]);
  for (int i = 0; i < kLanes; i += 4) {
    const Vector r0 = cv::v_load(x0 + b.re + i);
    const Vector i0 = cv::v_load(x0 + b.im + i);
    const Vector r1 = cv::v_load(x1 + b.re + i);
    const Vector i1 = cv::v_load(x1 + b.im + i);
    const Vector dr = r0 - r1;
    const Vector di = i0 - i1;
    cv::v_store(y0 + b.re + i, r0 + r1);
    cv::v_store(y0 + b.im + i, i0 + i1);
    cv::v_store(y1 + b.re + i, dr * c - di * s);
    cv::v_store(y1 + b.im + i, dr * s + di * c);
  }
}

void Radix3(const Butterfly& b) {
  const Vector sine = cv::v_setall_f32(std::numbers::sqrt3_v<float> / 2.0F);
  const Vector half = cv::v_setall_f32(0.5F);
  const float* __restrict x0 = b.in;
  const float* __restrict x1 = b.in + b.in_pitch;
  const float* __restrict x2 = b.in + 2 * b.in_pitch;
  float* __restrict y0 = b.out;
  float* __restrict y1 = b.out + b.out_pitch;
  float* __restrict y2 = b.out + 2 * b.out_pitch;
  const Vector c1 = cv::v_setall_f32(b.twiddle[0]);
  const Vector s1 = cv::v_setall_f32(b.twiddle[1]);
  const Vector c2 = cv::v_setall_f32(b.twiddle[2]);
  const Vector s2 = cv::v_setall_f32(b.twiddle[3]);
  for (int i = 0; i < kLanes; i += 4) {
    const Vector sr = cv::v_load(x1 + b.re + i) + cv::v_load(x2 + b.re + i);
    const Vector si = cv::v_load(x1 + b.im + i) + cv::v_load(x2 + b.im + i);
    const Vector dr =
        sine * (cv::v_load(x1 + b.re + i) - cv::v_load(x2 + b.re + i));
    const Vector di =
        sine * (cv::v_load(x1 + b.im + i) - cv::v_load(x2 + b.im + i));
    const Vector mr = cv::v_load(x0 + b.re + i) - half * sr;
    const Vector mi = cv::v_load(x0 + b.im + i) - half * si;
    cv::v_store(y0 + b.re + i, cv::v_load(x0 + b.re + i) + sr);
    cv::v_store(y0 + b.im + i, cv::v_load(x0 + b.im + i) + si);
    const Vector r1 = mr + di;
    const Vector i1 = mi - dr;
    const Vector r2 = mr - di;
    const Vector i2 = mi + dr;
    cv::v_store(y1 + b.re + i, r1 * c1 - i1 * s1);
    cv::v_store(y1 + b.im + i, r1 * s1 + i1 * c1);
    cv::v_store(y2 + b.re + i, r2 * c2 - i2 * s2);
    cv::v_store(y2 + b.im + i, r2 * s2 + i2 * c2);
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
  std::array<Vector, 6> w;
  for (int i = 0; i < 6; ++i) w[i] = cv::v_setall_f32(b.twiddle[i]);
  for (int i = 0; i < kLanes; i += 4) {
    const Vector ar = cv::v_load(x0 + b.re + i) + cv::v_load(x2 + b.re + i);
    const Vector ai = cv::v_load(x0 + b.im + i) + cv::v_load(x2 + b.im + i);
    const Vector br = cv::v_load(x0 + b.re + i) - cv::v_load(x2 + b.re + i);
    const Vector bi = cv::v_load(x0 + b.im + i) - cv::v_load(x2 + b.im + i);
    const Vector cr = cv::v_load(x1 + b.re + i) + cv::v_load(x3 + b.re + i);
    const Vector ci = cv::v_load(x1 + b.im + i) + cv::v_load(x3 + b.im + i);
    const Vector dr = cv::v_load(x1 + b.re + i) - cv::v_load(x3 + b.re + i);
    const Vector di = cv::v_load(x1 + b.im + i) - cv::v_load(x3 + b.im + i);
    cv::v_store(y0 + b.re + i, ar + cr);
    cv::v_store(y0 + b.im + i, ai + ci);
    const Vector r1 = br + di;
    const Vector i1 = bi - dr;
    const Vector r2 = ar - cr;
    const Vector i2 = ai - ci;
    const Vector r3 = br - di;
    const Vector i3 = bi + dr;
    cv::v_store(y1 + b.re + i, r1 * w[0] - i1 * w[1]);
    cv::v_store(y1 + b.im + i, r1 * w[1] + i1 * w[0]);
    cv::v_store(y2 + b.re + i, r2 * w[2] - i2 * w[3]);
    cv::v_store(y2 + b.im + i, r2 * w[3] + i2 * w[2]);
    cv::v_store(y3 + b.re + i, r3 * w[4] - i3 * w[5]);
    cv::v_store(y3 + b.im + i, r3 * w[5] + i3 * w[4]);
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
