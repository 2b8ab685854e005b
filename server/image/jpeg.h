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

// CV_8UC3, BGR, of `size_px`, which ReadJpegSize gave and the caller found
// acceptable. Data that libjpeg would only warn about (it fills the missing
// part with gray) is kInvalidArgument: half a frame must not be tracked on.
absl::StatusOr<cv::Mat> DecodeJpeg(std::span<const std::uint8_t> bytes,
                                   cv::Size size_px);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_JPEG_H_
