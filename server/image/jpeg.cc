// SPDX-License-Identifier: Apache-2.0
#include "server/image/jpeg.h"

#include <turbojpeg.h>

#include <memory>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace groundlock::image {
namespace {

struct DestroyHandle {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using Handle = std::unique_ptr<void, DestroyHandle>;

absl::StatusOr<Handle> MakeDecompressor() {
  Handle handle(tjInitDecompress());
  if (handle == nullptr) {
    return absl::InternalError(absl::StrCat("cannot start the JPEG decoder: ",
                                            tjGetErrorStr2(nullptr)));
  }
  return handle;
}

}  // namespace

bool HasJpegMagic(std::span<const std::uint8_t> bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xFF && bytes[1] == 0xD8 &&
         bytes[2] == 0xFF;
}

absl::StatusOr<cv::Size> ReadJpegSize(std::span<const std::uint8_t> bytes) {
  auto handle = MakeDecompressor();
  if (!handle.ok()) return handle.status();
  int width_px = 0;
  int height_px = 0;
  int subsampling = 0;
  int colorspace = 0;
  if (tjDecompressHeader3(handle->get(),
                          bytes.data(),
                          bytes.size(),
                          &width_px,
                          &height_px,
                          &subsampling,
                          &colorspace) != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "JPEG: damaged or truncated header: ", tjGetErrorStr2(handle->get())));
  }
  if (colorspace == TJCS_CMYK || colorspace == TJCS_YCCK) {
    return absl::InvalidArgumentError(
        "JPEG: CMYK images are not supported; send gray, YCbCr or RGB");
  }
  if (width_px <= 0 || height_px <= 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("JPEG: the header says ", width_px, "x", height_px));
  }
  return cv::Size(width_px, height_px);
}

absl::StatusOr<cv::Mat> DecodeJpeg(std::span<const std::uint8_t> bytes,
                                   cv::Size size_px) {
  auto handle = MakeDecompressor();
  if (!handle.ok()) return handle.status();
  cv::Mat bgr(size_px, CV_8UC3);
  // LIMITSCANS bounds the time of progressive files made of thousands of
  // scans.
  if (tjDecompress2(handle->get(),
                    bytes.data(),
                    bytes.size(),
                    bgr.data,
                    size_px.width,
                    static_cast<int>(bgr.step[0]),
                    size_px.height,
                    TJPF_BGR,
                    TJFLAG_STOPONWARNING | TJFLAG_LIMITSCANS) != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "JPEG: damaged or truncated data: ", tjGetErrorStr2(handle->get())));
  }
  return bgr;
}

}  // namespace groundlock::image
