// SPDX-License-Identifier: Apache-2.0
// PNG by OpenCV (libpng). Internal to the room: see frame.h.
#ifndef GROUNDLOCK_SERVER_IMAGE_PNG_H_
#define GROUNDLOCK_SERVER_IMAGE_PNG_H_

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <span>

#include "absl/status/statusor.h"

namespace groundlock::image {

bool HasPngMagic(std::span<const std::uint8_t> bytes);

// Size from the IHDR chunk, parsed here: OpenCV would allocate first and ask
// later. kInvalidArgument if there is none.
absl::StatusOr<cv::Size> ReadPngSize(std::span<const std::uint8_t> bytes);

// CV_8UC3, BGR, of `size_px`, which ReadPngSize gave and the caller found
// acceptable. Alpha is dropped. kInvalidArgument if damaged or truncated.
absl::StatusOr<cv::Mat> DecodePng(std::span<const std::uint8_t> bytes,
                                  cv::Size size_px);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_PNG_H_
