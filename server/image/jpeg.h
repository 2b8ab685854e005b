// SPDX-License-Identifier: Apache-2.0
// JPEG by libturbojpeg. Internal to the room: see frame.h.
#ifndef GROUNDLOCK_SERVER_IMAGE_JPEG_H_
#define GROUNDLOCK_SERVER_IMAGE_JPEG_H_

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <span>

#include "absl/status/statusor.h"

namespace groundlock::image {

bool HasJpegMagic(std::span<const std::uint8_t> bytes);

// Size from the header. kInvalidArgument if there is none.
absl::StatusOr<cv::Size> ReadJpegSize(std::span<const std::uint8_t> bytes);

// What a JPEG holds, CV_8UC1 planes as ColourPicture takes them. `cb` and `cr`
// are empty for a gray picture. Files of unusual make (RGB, other subsampling
// than 4:4:4, 4:2:2, 4:2:0, 4:4:0 and 4:1:1) come as CV_8UC3 `bgr` instead, and
// the planes are empty.
struct JpegPixels {
  cv::Mat luma, cb, cr;
  cv::Mat bgr;
};

// Of `size_px`, which ReadJpegSize gave and the caller found acceptable. Data
// that libjpeg would only warn about (it fills the missing part with gray) is
// kInvalidArgument: half a frame must not be tracked on.
absl::StatusOr<JpegPixels> DecodeJpeg(std::span<const std::uint8_t> bytes,
                                      cv::Size size_px);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_JPEG_H_
