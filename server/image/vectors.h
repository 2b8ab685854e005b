// SPDX-License-Identifier: Apache-2.0
// Eight numbers that are worked on at once, in the machine's vectors.
#ifndef GROUNDLOCK_SERVER_IMAGE_VECTORS_H_
#define GROUNDLOCK_SERVER_IMAGE_VECTORS_H_

#include <cstdint>
#include <opencv2/core/hal/intrin.hpp>

#include "map_store/base/processor.h"

// The innermost loops are written once, in *_kernels.inc, by the names below,
// and compiled twice (at_both_widths.inc): in namespace `narrow` by OpenCV's
// vectors of four, which any machine has, and in namespace `wide` by AVX2's of
// eight. GROUNDLOCK_WIDEST(kernel) is the one that suits the machine. Both do
// the same operations in the same order, without fused ones: results are the
// same to the bit with either, and on every maker's processors: there are no
// estimates of roots or reciprocals, which differ between them.
//
// `wide` is there on x86-64 in GCC's builds; clang and the sanitizers see
// `narrow` alone, so that the tests see both.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define GROUNDLOCK_WIDE_VECTORS 1
#include <immintrin.h>
#else
#define GROUNDLOCK_WIDE_VECTORS 0
#endif

namespace groundlock::image {

inline constexpr int kVectorFloats = 8;

// `count` up to whole vectors.
constexpr int WholeVectors(int count) {
  return (count + kVectorFloats - 1) / kVectorFloats * kVectorFloats;
}

#if GROUNDLOCK_WIDE_VECTORS
inline const bool kMachineIsWide = base::MayUseAvx2();
#define GROUNDLOCK_WIDEST(kernel) \
  (::groundlock::image::kMachineIsWide ? &wide::kernel : &narrow::kernel)
#else
#define GROUNDLOCK_WIDEST(kernel) (&narrow::kernel)
#endif

namespace narrow {

struct Floats {
  cv::v_float32x4 low, high;
};
struct Ints {
  cv::v_int32x4 low, high;
};

inline Floats Load(const float* p) {
  return {cv::v_load(p), cv::v_load(p + 4)};
}
inline void Store(float* p, const Floats& a) {
  cv::v_store(p, a.low);
  cv::v_store(p + 4, a.high);
}
inline void Store(std::int32_t* p, const Ints& a) {
  cv::v_store(p, a.low);
  cv::v_store(p + 4, a.high);
}
inline Floats All(float value) {
  const cv::v_float32x4 all = cv::v_setall_f32(value);
  return {all, all};
}
// Of eight bytes.
inline Floats FromBytes(const std::uint8_t* p) {
  const cv::v_uint16x8 words = cv::v_load_expand(p);
  cv::v_uint32x4 low;
  cv::v_uint32x4 high;
  cv::v_expand(words, low, high);
  return {cv::v_cvt_f32(cv::v_reinterpret_as_s32(low)),
          cv::v_cvt_f32(cv::v_reinterpret_as_s32(high))};
}
// Of eight pairs of bytes that follow one another.
inline void FromPairsOfBytes(const std::uint16_t* p,
                             Floats& first,
                             Floats& second) {
  const cv::v_uint16x8 pairs = cv::v_load(p);
  const auto floats = [](const cv::v_uint16x8& words) {
    cv::v_uint32x4 low;
    cv::v_uint32x4 high;
    cv::v_expand(words, low, high);
    return Floats{cv::v_cvt_f32(cv::v_reinterpret_as_s32(low)),
                  cv::v_cvt_f32(cv::v_reinterpret_as_s32(high))};
  };
  first = floats(pairs & cv::v_setall_u16(0xFF));
  second = floats(cv::v_shr<8>(pairs));
}
inline Floats operator+(const Floats& a, const Floats& b) {
  return {a.low + b.low, a.high + b.high};
}
inline Floats operator-(const Floats& a, const Floats& b) {
  return {a.low - b.low, a.high - b.high};
}
inline Floats operator*(const Floats& a, const Floats& b) {
  return {a.low * b.low, a.high * b.high};
}
inline Floats operator/(const Floats& a, const Floats& b) {
  return {a.low / b.low, a.high / b.high};
}
inline Floats Min(const Floats& a, const Floats& b) {
  return {cv::v_min(a.low, b.low), cv::v_min(a.high, b.high)};
}
inline Floats Max(const Floats& a, const Floats& b) {
  return {cv::v_max(a.low, b.low), cv::v_max(a.high, b.high)};
}
inline Floats Sqrt(const Floats& a) {
  return {cv::v_sqrt(a.low), cv::v_sqrt(a.high)};
}
inline Floats Abs(const Floats& a) {
  return {cv::v_abs(a.low), cv::v_abs(a.high)};
}
// All bits where a > b, else none: a mask for Select and And.
inline Floats Greater(const Floats& a, const Floats& b) {
  return {a.low > b.low, a.high > b.high};
}
inline Floats And(const Floats& mask, const Floats& a) {
  return {mask.low & a.low, mask.high & a.high};
}
inline Floats Select(const Floats& mask, const Floats& a, const Floats& b) {
  return {cv::v_select(mask.low, a.low, b.low),
          cv::v_select(mask.high, a.high, b.high)};
}
// Towards zero.
inline Ints ToInts(const Floats& a) {
  return {cv::v_trunc(a.low), cv::v_trunc(a.high)};
}
inline Floats ToFloats(const Ints& a) {
  return {cv::v_cvt_f32(a.low), cv::v_cvt_f32(a.high)};
}
template <int kBits>
Ints ShiftRight(const Ints& a) {
  return {cv::v_shr<kBits>(a.low), cv::v_shr<kBits>(a.high)};
}
template <int kBits>
Ints ShiftLeft(const Ints& a) {
  return {cv::v_shl<kBits>(a.low), cv::v_shl<kBits>(a.high)};
}
inline Ints operator|(const Ints& a, const Ints& b) {
  return {a.low | b.low, a.high | b.high};
}
// Two vectors to pairs of numbers, and back.
inline void StorePairs(float* p, const Floats& a, const Floats& b) {
  cv::v_store_interleave(p, a.low, b.low);
  cv::v_store_interleave(p + 8, a.high, b.high);
}
inline void LoadPairs(const float* p, Floats& a, Floats& b) {
  cv::v_load_deinterleave(p, a.low, b.low);
  cv::v_load_deinterleave(p + 8, a.high, b.high);
}
// Four vectors to groups of four.
inline void StoreFours(float* p,
                       const Floats& a,
                       const Floats& b,
                       const Floats& c,
                       const Floats& d) {
  cv::v_store_interleave(p, a.low, b.low, c.low, d.low);
  cv::v_store_interleave(p + 16, a.high, b.high, c.high, d.high);
}
// Row i becomes column i.
inline void Transpose(Floats (&rows)[kVectorFloats]) {
  Floats columns[kVectorFloats];
  for (int half = 0; half < 2; ++half) {
    const int at = 4 * half;
    cv::v_transpose4x4(rows[at].low,
                       rows[at + 1].low,
                       rows[at + 2].low,
                       rows[at + 3].low,
                       half == 0 ? columns[0].low : columns[0].high,
                       half == 0 ? columns[1].low : columns[1].high,
                       half == 0 ? columns[2].low : columns[2].high,
                       half == 0 ? columns[3].low : columns[3].high);
    cv::v_transpose4x4(rows[at].high,
                       rows[at + 1].high,
                       rows[at + 2].high,
                       rows[at + 3].high,
                       half == 0 ? columns[4].low : columns[4].high,
                       half == 0 ? columns[5].low : columns[5].high,
                       half == 0 ? columns[6].low : columns[6].high,
                       half == 0 ? columns[7].low : columns[7].high);
  }
  for (int i = 0; i < kVectorFloats; ++i) rows[i] = columns[i];
}

}  // namespace narrow

#if GROUNDLOCK_WIDE_VECTORS
#pragma GCC push_options
#pragma GCC target("avx2")
namespace wide {

struct Floats {
  __m256 all;
};
struct Ints {
  __m256i all;
};

inline Floats Load(const float* p) { return {_mm256_loadu_ps(p)}; }
inline void Store(float* p, const Floats& a) { _mm256_storeu_ps(p, a.all); }
inline void Store(std::int32_t* p, const Ints& a) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), a.all);
}
inline Floats All(float value) { return {_mm256_set1_ps(value)}; }
inline Floats FromBytes(const std::uint8_t* p) {
  return {_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(
      _mm_loadl_epi64(reinterpret_cast<const __m128i*>(p))))};
}
inline void FromPairsOfBytes(const std::uint16_t* p,
                             Floats& first,
                             Floats& second) {
  const __m256i pairs = _mm256_cvtepu16_epi32(
      _mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
  first.all =
      _mm256_cvtepi32_ps(_mm256_and_si256(pairs, _mm256_set1_epi32(0xFF)));
  second.all = _mm256_cvtepi32_ps(_mm256_srli_epi32(pairs, 8));
}
inline Floats operator+(const Floats& a, const Floats& b) {
  return {_mm256_add_ps(a.all, b.all)};
}
inline Floats operator-(const Floats& a, const Floats& b) {
  return {_mm256_sub_ps(a.all, b.all)};
}
inline Floats operator*(const Floats& a, const Floats& b) {
  return {_mm256_mul_ps(a.all, b.all)};
}
inline Floats operator/(const Floats& a, const Floats& b) {
  return {_mm256_div_ps(a.all, b.all)};
}
inline Floats Min(const Floats& a, const Floats& b) {
  return {_mm256_min_ps(a.all, b.all)};
}
inline Floats Max(const Floats& a, const Floats& b) {
  return {_mm256_max_ps(a.all, b.all)};
}
inline Floats Sqrt(const Floats& a) { return {_mm256_sqrt_ps(a.all)}; }
inline Floats Abs(const Floats& a) {
  return {_mm256_andnot_ps(_mm256_set1_ps(-0.0F), a.all)};
}
inline Floats Greater(const Floats& a, const Floats& b) {
  return {_mm256_cmp_ps(a.all, b.all, _CMP_GT_OQ)};
}
inline Floats And(const Floats& mask, const Floats& a) {
  return {_mm256_and_ps(mask.all, a.all)};
}
inline Floats Select(const Floats& mask, const Floats& a, const Floats& b) {
  return {_mm256_blendv_ps(b.all, a.all, mask.all)};
}
inline Ints ToInts(const Floats& a) { return {_mm256_cvttps_epi32(a.all)}; }
inline Floats ToFloats(const Ints& a) { return {_mm256_cvtepi32_ps(a.all)}; }
template <int kBits>
Ints ShiftRight(const Ints& a) {
  return {_mm256_srai_epi32(a.all, kBits)};
}
template <int kBits>
Ints ShiftLeft(const Ints& a) {
  return {_mm256_slli_epi32(a.all, kBits)};
}
inline Ints operator|(const Ints& a, const Ints& b) {
  return {_mm256_or_si256(a.all, b.all)};
}
inline void StorePairs(float* p, const Floats& a, const Floats& b) {
  const __m256 low = _mm256_unpacklo_ps(a.all, b.all);
  const __m256 high = _mm256_unpackhi_ps(a.all, b.all);
  _mm256_storeu_ps(p, _mm256_permute2f128_ps(low, high, 0x20));
  _mm256_storeu_ps(p + 8, _mm256_permute2f128_ps(low, high, 0x31));
}
inline void LoadPairs(const float* p, Floats& a, Floats& b) {
  const __m256 first = _mm256_loadu_ps(p);
  const __m256 second = _mm256_loadu_ps(p + 8);
  const __m256 low = _mm256_permute2f128_ps(first, second, 0x20);
  const __m256 high = _mm256_permute2f128_ps(first, second, 0x31);
  a.all = _mm256_shuffle_ps(low, high, _MM_SHUFFLE(2, 0, 2, 0));
  b.all = _mm256_shuffle_ps(low, high, _MM_SHUFFLE(3, 1, 3, 1));
}
inline void StoreFours(float* p,
                       const Floats& a,
                       const Floats& b,
                       const Floats& c,
                       const Floats& d) {
  const __m256 ab_low = _mm256_unpacklo_ps(a.all, b.all);
  const __m256 ab_high = _mm256_unpackhi_ps(a.all, b.all);
  const __m256 cd_low = _mm256_unpacklo_ps(c.all, d.all);
  const __m256 cd_high = _mm256_unpackhi_ps(c.all, d.all);
  // Numbers i and i + 4.
  const __m256 i0 = _mm256_shuffle_ps(ab_low, cd_low, _MM_SHUFFLE(1, 0, 1, 0));
  const __m256 i1 = _mm256_shuffle_ps(ab_low, cd_low, _MM_SHUFFLE(3, 2, 3, 2));
  const __m256 i2 =
      _mm256_shuffle_ps(ab_high, cd_high, _MM_SHUFFLE(1, 0, 1, 0));
  const __m256 i3 =
      _mm256_shuffle_ps(ab_high, cd_high, _MM_SHUFFLE(3, 2, 3, 2));
  _mm256_storeu_ps(p, _mm256_permute2f128_ps(i0, i1, 0x20));
  _mm256_storeu_ps(p + 8, _mm256_permute2f128_ps(i2, i3, 0x20));
  _mm256_storeu_ps(p + 16, _mm256_permute2f128_ps(i0, i1, 0x31));
  _mm256_storeu_ps(p + 24, _mm256_permute2f128_ps(i2, i3, 0x31));
}
inline void Transpose(Floats (&rows)[kVectorFloats]) {
  // Pairs of rows, then of pairs, then of halves.
  __m256 pairs[kVectorFloats];
  for (int i = 0; i < kVectorFloats; i += 2) {
    pairs[i] = _mm256_unpacklo_ps(rows[i].all, rows[i + 1].all);
    pairs[i + 1] = _mm256_unpackhi_ps(rows[i].all, rows[i + 1].all);
  }
  __m256 fours[kVectorFloats];
  for (int i = 0; i < kVectorFloats; i += 4) {
    for (int k = 0; k < 2; ++k) {
      fours[i + 2 * k] = _mm256_shuffle_ps(
          pairs[i + k], pairs[i + k + 2], _MM_SHUFFLE(1, 0, 1, 0));
      fours[i + 2 * k + 1] = _mm256_shuffle_ps(
          pairs[i + k], pairs[i + k + 2], _MM_SHUFFLE(3, 2, 3, 2));
    }
  }
  for (int i = 0; i < 4; ++i) {
    rows[i].all = _mm256_permute2f128_ps(fours[i], fours[i + 4], 0x20);
    rows[i + 4].all = _mm256_permute2f128_ps(fours[i], fours[i + 4], 0x31);
  }
}

}  // namespace wide
#pragma GCC pop_options
#endif

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_VECTORS_H_
