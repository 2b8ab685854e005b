// SPDX-License-Identifier: Apache-2.0
#include "server/image/frame.h"

#include <limits>
#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "server/image/jpeg.h"
#include "server/image/png.h"

namespace groundlock::image {
namespace {

// Encoded bytes beyond this cannot be handed to OpenCV, which counts in int.
constexpr std::size_t kMaxBytes = std::numeric_limits<int>::max();

bool IsRaw(Encoding encoding) {
  return encoding == Encoding::kRawGray8 || encoding == Encoding::kRawBgr8 ||
         encoding == Encoding::kRawRgb8;
}

absl::Status CheckLimits(cv::Size size_px, const ImageLimits& limits) {
  const std::int64_t pixels = std::int64_t{size_px.width} * size_px.height;
  if (size_px.width > limits.max_width_px ||
      size_px.height > limits.max_height_px || pixels > limits.max_pixels) {
    return absl::ResourceExhaustedError(
        absl::StrCat("image of ",
                     size_px.width,
                     "x",
                     size_px.height,
                     " pixels is larger than the limits: ",
                     limits.max_width_px,
                     "x",
                     limits.max_height_px,
                     ", ",
                     limits.max_pixels,
                     " pixels in all"));
  }
  return absl::OkStatus();
}

absl::StatusOr<Encoding> ResolveEncoding(const EncodedImage& encoded) {
  if (encoded.bytes.empty()) {
    return absl::InvalidArgumentError("image is empty (0 bytes)");
  }
  if (encoded.bytes.size() > kMaxBytes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("image of ", encoded.bytes.size(), " bytes is too large"));
  }
  if (encoded.encoding != Encoding::kAuto) return encoded.encoding;
  if (HasJpegMagic(encoded.bytes)) return Encoding::kJpeg;
  if (HasPngMagic(encoded.bytes)) return Encoding::kPng;
  return absl::InvalidArgumentError(
      "image is neither JPEG nor PNG; name its encoding if it is raw");
}

absl::StatusOr<cv::Size> ReadSize(Encoding encoding,
                                  const EncodedImage& encoded) {
  if (encoding == Encoding::kJpeg) return ReadJpegSize(encoded.bytes);
  if (encoding == Encoding::kPng) return ReadPngSize(encoded.bytes);
  if (!IsRaw(encoding)) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown image encoding ", static_cast<int>(encoding)));
  }
  if (encoded.width_px <= 0 || encoded.height_px <= 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("raw image needs a positive width and height, got ",
                     encoded.width_px,
                     "x",
                     encoded.height_px));
  }
  return cv::Size(encoded.width_px, encoded.height_px);
}

absl::Status DecodeRaw(Encoding encoding,
                       std::span<const std::uint8_t> bytes,
                       cv::Size size_px,
                       Frame& frame) {
  const std::int64_t channels = encoding == Encoding::kRawGray8 ? 1 : 3;
  const std::int64_t expected =
      std::int64_t{size_px.width} * size_px.height * channels;
  if (static_cast<std::int64_t>(bytes.size()) != expected) {
    return absl::InvalidArgumentError(absl::StrCat("raw image of ",
                                                   size_px.width,
                                                   "x",
                                                   size_px.height,
                                                   " with ",
                                                   channels,
                                                   " channels needs ",
                                                   expected,
                                                   " bytes, got ",
                                                   bytes.size()));
  }
  // A view of the caller's bytes, which are only read; the frame owns copies.
  const cv::Mat source(size_px,
                       CV_MAKETYPE(CV_8U, static_cast<int>(channels)),
                       const_cast<std::uint8_t*>(bytes.data()));
  if (encoding == Encoding::kRawGray8) {
    frame.luma = source.clone();
  } else if (encoding == Encoding::kRawBgr8) {
    frame = Frame::FromBgr(source.clone());
  } else {
    cv::Mat bgr;
    cv::cvtColor(source, bgr, cv::COLOR_RGB2BGR);
    frame = Frame::FromBgr(bgr);
  }
  return absl::OkStatus();
}

}  // namespace

Frame Frame::FromBgr(const cv::Mat& bgr) {
  Frame frame;
  cv::cvtColor(bgr, frame.luma, cv::COLOR_BGR2GRAY);
  frame.colour = std::make_shared<ColourPicture>(bgr);
  return frame;
}

const cv::Mat& Frame::Bgr(const cv::Rect& region_px, int halvings) const {
  if (colour == nullptr) colour = std::make_shared<ColourPicture>(luma);
  return colour->Bgr(region_px, halvings);
}

std::shared_ptr<const LumaPyramid> Frame::Pyramid() const {
  if (pyramid_ == nullptr) pyramid_ = BuildPyramid(luma);
  return pyramid_;
}

absl::StatusOr<cv::Size> ReadImageSize(const EncodedImage& encoded) {
  ASSIGN_OR_RETURN(const Encoding encoding, ResolveEncoding(encoded));
  return ReadSize(encoding, encoded);
}

absl::StatusOr<Frame> DecodeImage(const EncodedImage& encoded,
                                  const ImageLimits& limits) {
  ASSIGN_OR_RETURN(const Encoding encoding, ResolveEncoding(encoded));
  ASSIGN_OR_RETURN(const cv::Size size_px, ReadSize(encoding, encoded));
  RETURN_IF_ERROR(CheckLimits(size_px, limits));
  Frame frame;
  try {
    if (encoding == Encoding::kJpeg) {
      ASSIGN_OR_RETURN(JpegPixels pixels, DecodeJpeg(encoded.bytes, size_px));
      if (!pixels.bgr.empty()) {
        frame = Frame::FromBgr(pixels.bgr);
      } else {
        frame.luma = pixels.luma;
        if (!pixels.cb.empty()) {
          frame.colour = std::make_shared<ColourPicture>(
              pixels.luma, pixels.cb, pixels.cr);
        }
      }
    } else if (encoding == Encoding::kPng) {
      ASSIGN_OR_RETURN(const cv::Mat bgr, DecodePng(encoded.bytes, size_px));
      frame = Frame::FromBgr(bgr);
    } else {
      RETURN_IF_ERROR(DecodeRaw(encoding, encoded.bytes, size_px, frame));
    }
  } catch (const cv::Exception& error) {
    return absl::InternalError(absl::StrCat("image: ", error.err));
  }
  return frame;
}

}  // namespace groundlock::image
