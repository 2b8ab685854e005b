// SPDX-License-Identifier: Apache-2.0
#include "server/image/jpeg.h"

#include <turbojpeg.h>

#include <memory>
#include <opencv2/core.hpp>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "server/image/luma_pyramid.h"

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

// LIMITSCANS bounds the time of progressive files made of thousands of scans.
constexpr int kFlags = TJFLAG_STOPONWARNING | TJFLAG_LIMITSCANS;

struct Header {
  cv::Size size_px;
  int subsampling = -1;  // TJSAMP_*, or -1: none of those
  int colorspace = -1;   // TJCS_*
};

absl::StatusOr<Header> ReadHeader(void* handle,
                                  std::span<const std::uint8_t> bytes) {
  Header header;
  const bool failed = tjDecompressHeader3(handle,
                                          bytes.data(),
                                          bytes.size(),
                                          &header.size_px.width,
                                          &header.size_px.height,
                                          &header.subsampling,
                                          &header.colorspace) != 0;
  // libturbojpeg calls it an error not to know the subsampling, though it
  // decodes such pictures; the rest of the header is then there.
  const bool only_odd_subsampling =
      header.size_px.width > 0 && header.size_px.height > 0 &&
      header.subsampling < 0 && header.colorspace >= 0;
  if (failed && !only_odd_subsampling) {
    return absl::InvalidArgumentError(absl::StrCat(
        "JPEG: damaged or truncated header: ", tjGetErrorStr2(handle)));
  }
  if (header.colorspace == TJCS_CMYK || header.colorspace == TJCS_YCCK) {
    return absl::InvalidArgumentError(
        "JPEG: CMYK images are not supported; send gray, YCbCr or RGB");
  }
  if (header.size_px.width <= 0 || header.size_px.height <= 0) {
    return absl::InvalidArgumentError(absl::StrCat("JPEG: the header says ",
                                                   header.size_px.width,
                                                   "x",
                                                   header.size_px.height));
  }
  return header;
}

// To one interleaved picture of `format`.
bool DecodeWhole(void* handle,
                 std::span<const std::uint8_t> bytes,
                 TJPF format,
                 cv::Mat& pixels) {
  return tjDecompress2(handle,
                       bytes.data(),
                       bytes.size(),
                       pixels.data,
                       pixels.cols,
                       static_cast<int>(pixels.step[0]),
                       pixels.rows,
                       format,
                       kFlags) == 0;
}

bool DecodePlanes(void* handle,
                  std::span<const std::uint8_t> bytes,
                  const Header& header,
                  JpegPixels& pixels) {
  const auto make_plane = [&](int component) {
    return cv::Mat(
        tjPlaneHeight(component, header.size_px.height, header.subsampling),
        tjPlaneWidth(component, header.size_px.width, header.subsampling),
        CV_8UC1);
  };
  // Within the border that a pyramid's first level needs.
  constexpr int kBorderPx = LumaPyramid::kWindowPx;
  const cv::Size planned(
      tjPlaneWidth(0, header.size_px.width, header.subsampling),
      tjPlaneHeight(0, header.size_px.height, header.subsampling));
  cv::Mat bordered(
      planned.height + 2 * kBorderPx, planned.width + 2 * kBorderPx, CV_8UC1);
  const cv::Mat luma =
      bordered(cv::Rect(cv::Point(kBorderPx, kBorderPx), planned));
  pixels.cb = make_plane(1);
  pixels.cr = make_plane(2);
  unsigned char* planes[3] = {luma.data, pixels.cb.data, pixels.cr.data};
  int strides[3] = {static_cast<int>(luma.step[0]),
                    static_cast<int>(pixels.cb.step[0]),
                    static_cast<int>(pixels.cr.step[0])};
  // The planes are padded to whole chroma samples.
  pixels.luma = luma(cv::Rect(cv::Point(), header.size_px));
  if (tjDecompressToYUVPlanes(handle,
                              bytes.data(),
                              bytes.size(),
                              planes,
                              header.size_px.width,
                              strides,
                              header.size_px.height,
                              kFlags) != 0) {
    return false;
  }
  // In place.
  cv::copyMakeBorder(pixels.luma,
                     bordered(cv::Rect(0,
                                       0,
                                       header.size_px.width + 2 * kBorderPx,
                                       header.size_px.height + 2 * kBorderPx)),
                     kBorderPx,
                     kBorderPx,
                     kBorderPx,
                     kBorderPx,
                     cv::BORDER_REFLECT_101 | cv::BORDER_ISOLATED);
  return true;
}

}  // namespace

bool HasJpegMagic(std::span<const std::uint8_t> bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xFF && bytes[1] == 0xD8 &&
         bytes[2] == 0xFF;
}

absl::StatusOr<cv::Size> ReadJpegSize(std::span<const std::uint8_t> bytes) {
  ASSIGN_OR_RETURN(const Handle handle, MakeDecompressor());
  ASSIGN_OR_RETURN(const Header header, ReadHeader(handle.get(), bytes));
  return header.size_px;
}

absl::StatusOr<JpegPixels> DecodeJpeg(std::span<const std::uint8_t> bytes,
                                      cv::Size size_px) {
  ASSIGN_OR_RETURN(const Handle handle, MakeDecompressor());
  ASSIGN_OR_RETURN(const Header header, ReadHeader(handle.get(), bytes));
  if (header.size_px != size_px) {
    return absl::InvalidArgumentError("JPEG: the size differs from the header");
  }
  JpegPixels pixels;
  bool decoded = false;
  if (header.colorspace == TJCS_GRAY) {
    pixels.luma.create(size_px, CV_8UC1);
    decoded = DecodeWhole(handle.get(), bytes, TJPF_GRAY, pixels.luma);
  } else if (header.colorspace == TJCS_YCbCr && header.subsampling >= 0 &&
             header.subsampling != TJSAMP_GRAY) {
    decoded = DecodePlanes(handle.get(), bytes, header, pixels);
  } else {
    pixels.bgr.create(size_px, CV_8UC3);
    decoded = DecodeWhole(handle.get(), bytes, TJPF_BGR, pixels.bgr);
  }
  if (!decoded) {
    return absl::InvalidArgumentError(absl::StrCat(
        "JPEG: damaged or truncated data: ", tjGetErrorStr2(handle.get())));
  }
  return pixels;
}

}  // namespace groundlock::image
