// SPDX-License-Identifier: Apache-2.0
// Bytes from a client become a frame that vision can look at.
#ifndef GROUNDLOCK_SERVER_IMAGE_FRAME_H_
#define GROUNDLOCK_SERVER_IMAGE_FRAME_H_

#include <chrono>
#include <cstdint>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/image/colour_picture.h"
#include "server/image/luma_pyramid.h"

namespace groundlock::image {

// Bounds on what is decoded; checked on the header, before pixels are
// allocated.
struct ImageLimits {
  int max_width_px = 8'192;
  int max_height_px = 8'192;
  std::int64_t max_pixels = 33'554'432;  // 32 Mi
};

enum class Encoding {
  kAuto,  // JPEG, PNG by their magic bytes
  kJpeg,
  kPng,
  kRawGray8,  // rows of width bytes, no padding
  kRawBgr8,
  kRawRgb8,
};

// An image as received. `width`/`height` are needed for raw encodings only.
struct EncodedImage {
  Encoding encoding = Encoding::kAuto;
  std::span<const std::uint8_t> bytes;
  int width_px = 0;
  int height_px = 0;
};

// One decoded frame. Immutable once made. Copies share pixels, and what is made
// of them on demand: copies of a frame belong to one thread at a time, their
// `luma` and pyramids to any.
struct Frame {
  // From pixels that are there; shared, not copied.
  static Frame FromBgr(const cv::Mat& bgr);  // CV_8UC3

  std::uint64_t sequence = 0;
  std::chrono::nanoseconds capture_time{0};  // client's clock, monotone
  cv::Mat luma;                              // CV_8UC1
  // What `luma` was seen in; null: in gray.
  mutable std::shared_ptr<ColourPicture> colour;

  cv::Size size_px() const { return luma.size(); }
  // CV_8UC3 of the frame's size, whose pixels are there within `region_px`
  // (clipped to the image); others hold anything. A gray source has equal
  // channels.
  // `halvings` in [0, ColourPicture::kMaxHalvings]: of the frame halved so
  // often, in whose pixels `region_px` then is.
  const cv::Mat& Bgr(const cv::Rect& region_px, int halvings = 0) const;
  const cv::Mat& Bgr() const { return Bgr({cv::Point(), size_px()}); }
  // Built when first asked for, without derivatives.
  std::shared_ptr<const LumaPyramid> Pyramid() const;

 private:
  mutable std::shared_ptr<const LumaPyramid> pyramid_;
};

// Pixel convention: the API and all rooms put the first pixel's centre at
// (0.5, 0.5); OpenCV functions put it at (0, 0). Code that calls OpenCV with
// coordinates adds or subtracts this once, at the call.
inline constexpr double kPixelCenter = 0.5;

// Width and height without decoding. Errors as DecodeImage.
absl::StatusOr<cv::Size> ReadImageSize(const EncodedImage& encoded);

// Decodes to luma; colour stays as the source has it until it is asked for.
// Orientation tags (EXIF) are not followed: a camera's intrinsics belong to the
// pixels as they lie. kInvalidArgument: empty, unknown format, truncated
// or damaged data, raw size not width x height x channels;
// kResourceExhausted: larger than the limits. Thread-safe.
absl::StatusOr<Frame> DecodeImage(const EncodedImage& encoded,
                                  const ImageLimits& limits);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_FRAME_H_
