// SPDX-License-Identifier: Apache-2.0
#include "server/image/ycc_to_bgr.h"

#include <algorithm>
#include <cstdint>
#include <opencv2/core/hal/intrin.hpp>
#include <vector>

namespace groundlock::image {
namespace {

// Pixels at once.
constexpr int kLanes = cv::v_uint8x16::nlanes;

// Rows of chroma at the picture's resolution.
class ChromaRows {
 public:
  explicit ChromaRows(const ChromaSamples& chroma)
      : chroma_(chroma),
        sums_(chroma.samples.cols + 2),
        row_(2 * chroma.samples.cols + kLanes) {}

  // Of row `y` of the picture, valid until the next call; as long as the
  // picture is wide, and readable for kLanes more.
  const std::uint8_t* Row(int y) {
    const cv::Mat& samples = chroma_.samples;
    const int count = samples.cols;
    const int at = chroma_.origin_px.y + y;
    const int nearest = std::min(at / chroma_.share_y, samples.rows - 1);
    // Of four quarters of the way, three are the nearest sample's.
    const int next = chroma_.share_y == 1 ? nearest
                     : at % 2 == 1 ? std::min(nearest + 1, samples.rows - 1)
                                   : std::max(nearest - 1, 0);
    const auto* __restrict a = samples.ptr<std::uint8_t>(nearest);
    const auto* __restrict b = samples.ptr<std::uint8_t>(next);
    std::uint16_t* __restrict sums = sums_.data() + 1;
    for (int x = 0; x < count; ++x) {
      sums[x] = static_cast<std::uint16_t>(3 * a[x] + b[x]);
    }
    sums[-1] = sums[0];
    sums[count] = sums[count - 1];
    std::uint8_t* __restrict row = row_.data();
    if (chroma_.share_x == 1) {
      for (int x = 0; x < count; ++x) {
        row[x] = static_cast<std::uint8_t>((sums[x] + 2) / 4);
      }
    } else {
      for (int x = 0; x < count; ++x) {
        const int three = 3 * sums[x] + 8;
        row[2 * x] = static_cast<std::uint8_t>((three + sums[x - 1]) / 16);
        row[2 * x + 1] = static_cast<std::uint8_t>((three + sums[x + 1]) / 16);
      }
    }
    return row + chroma_.origin_px.x;
  }

 private:
  const ChromaSamples& chroma_;
  std::vector<std::uint16_t> sums_;  // four times what they stand for
  std::vector<std::uint8_t> row_;
};

// 32 times factor * (chroma - 128), for factors below 2: both as sixteen bits,
// of whose product the upper half remains.
template <int kFactorTimes16384>
cv::v_int16x8 Times(const cv::v_int16x8& centred_times_128) {
  static_assert(kFactorTimes16384 < 1 << 15);
  return cv::v_mul_hi(
      centred_times_128,
      cv::v_setall_s16(static_cast<std::int16_t>(kFactorTimes16384)));
}

cv::v_int16x8 CentredTimes128(const cv::v_uint16x8& chroma) {
  return cv::v_shl<7>(cv::v_reinterpret_as_s16(chroma) - cv::v_setall_s16(128));
}

// Of 16 pixels.
void Convert(const std::uint8_t* y,
             const std::uint8_t* cb,
             const std::uint8_t* cr,
             std::uint8_t* bgr) {
  const auto half = [](int i,
                       const std::uint8_t* luma,
                       const std::uint8_t* blue,
                       const std::uint8_t* red,
                       cv::v_int16x8& b,
                       cv::v_int16x8& g,
                       cv::v_int16x8& r) {
    const cv::v_int16x8 value =
        cv::v_reinterpret_as_s16(cv::v_load_expand(luma + 8 * i));
    const cv::v_int16x8 u = CentredTimes128(cv::v_load_expand(blue + 8 * i));
    const cv::v_int16x8 v = CentredTimes128(cv::v_load_expand(red + 8 * i));
    const cv::v_int16x8 round = cv::v_setall_s16(16);
    b = value + cv::v_shr<5>(Times<29'032>(u) + round);  // 1.772
    g = value - cv::v_shr<5>(Times<5'638>(u) + Times<11'700>(v) +
                             round);                     // 0.34414, 0.71414
    r = value + cv::v_shr<5>(Times<22'970>(v) + round);  // 1.402
  };
  cv::v_int16x8 b[2];
  cv::v_int16x8 g[2];
  cv::v_int16x8 r[2];
  for (int i = 0; i < 2; ++i) half(i, y, cb, cr, b[i], g[i], r[i]);
  cv::v_store_interleave(bgr,
                         cv::v_pack_u(b[0], b[1]),
                         cv::v_pack_u(g[0], g[1]),
                         cv::v_pack_u(r[0], r[1]));
}

}  // namespace

void YccToBgr(const cv::Mat& luma,
              const ChromaSamples& cb,
              const ChromaSamples& cr,
              cv::Mat& bgr) {
  ChromaRows blue(cb);
  ChromaRows red(cr);
  const int whole = luma.cols / kLanes * kLanes;
  for (int row = 0; row < luma.rows; ++row) {
    const auto* y = luma.ptr<std::uint8_t>(row);
    const std::uint8_t* u = blue.Row(row);
    const std::uint8_t* v = red.Row(row);
    auto* out = bgr.ptr<std::uint8_t>(row);
    for (int x = 0; x < whole; x += kLanes) {
      Convert(y + x, u + x, v + x, out + 3 * static_cast<std::ptrdiff_t>(x));
    }
    if (whole == luma.cols) continue;
    std::uint8_t rest[kLanes] = {};
    std::copy(y + whole, y + luma.cols, rest);
    std::uint8_t pixels[3 * kLanes];
    Convert(rest, u + whole, v + whole, pixels);
    std::copy_n(pixels,
                3 * (luma.cols - whole),
                out + 3 * static_cast<std::ptrdiff_t>(whole));
  }
}

}  // namespace groundlock::image
