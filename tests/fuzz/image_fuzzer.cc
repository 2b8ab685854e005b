// SPDX-License-Identifier: Apache-2.0
// Any bytes, under any encoding, give a frame of the size they promised or an
// error. The first three bytes choose the encoding and the raw size.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "server/image/frame.h"

namespace gl = groundlock::image;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size < 3) return 0;
  constexpr int kNumEncodings = 6;
  const gl::EncodedImage encoded{
      .encoding = static_cast<gl::Encoding>(data[0] % kNumEncodings),
      .bytes = std::span(data, size).subspan(3),
      .width_px = data[1],
      .height_px = data[2]};
  const gl::ImageLimits limits{2'048, 2'048, 1 << 20};
  const auto size_px = gl::ReadImageSize(encoded);
  const auto frame = gl::DecodeImage(encoded, limits);
  if (!frame.ok()) return 0;
  if (!size_px.ok() || frame->bgr.size() != *size_px ||
      frame->luma.size() != *size_px || frame->bgr.type() != CV_8UC3 ||
      frame->luma.type() != CV_8UC1) {
    std::abort();
  }
  return 0;
}
