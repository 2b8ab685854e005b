// SPDX-License-Identifier: Apache-2.0
// Any bytes, under any encoding, give a frame of the size they promised or an
// error. The first three bytes choose the encoding and the raw size.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <opencv2/core.hpp>
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
  if (!size_px.ok() || frame->luma.size() != *size_px ||
      frame->luma.type() != CV_8UC1) {
    std::abort();
  }
  // A region of it in colour, chosen by the data and partly outside; then all:
  // the region must be the same in either.
  const cv::Rect region(data[1] - 64, data[2] - 64, data[1] / 2, data[2] / 2);
  const cv::Rect inside = region & cv::Rect(cv::Point(), *size_px);
  const cv::Mat part = frame->Bgr(region)(inside).clone();
  const auto again = gl::DecodeImage(encoded, limits);
  if (!again.ok()) std::abort();
  const cv::Mat& whole = again->Bgr();
  if (whole.size() != *size_px || whole.type() != CV_8UC3 ||
      (!part.empty() && cv::norm(part, whole(inside), cv::NORM_INF) > 1.0)) {
    std::abort();
  }
  return 0;
}
