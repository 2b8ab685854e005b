// SPDX-License-Identifier: Apache-2.0
#include "client/media/frame_encoder.h"

#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "map_store/base/status.h"

namespace groundlock::media {
namespace {

constexpr int kJpegQuality = 75;

bool IsLoopback(std::string_view server) {
  absl::string_view host = base::Abseil(server);
  if (!absl::ConsumePrefix(&host, "grpcs://")) {
    absl::ConsumePrefix(&host, "grpc://");
  }
  return host.empty() || absl::StartsWith(host, "127.") ||
         absl::StartsWith(host, "[::1]") ||
         absl::StartsWith(host, "localhost:") || host == "localhost" ||
         absl::StartsWith(host, "unix:");
}

sdk::Image RawImage(const cv::Mat& bgr) {
  sdk::Image image;
  image.encoding = sdk::ImageEncoding::kRawBgr8;
  image.width_px = bgr.cols;
  image.height_px = bgr.rows;
  const size_t row_bytes = static_cast<size_t>(bgr.cols) * 3;
  image.bytes.reserve(row_bytes * bgr.rows);
  for (int y = 0; y < bgr.rows; ++y) {
    image.bytes.append(reinterpret_cast<const char*>(bgr.ptr(y)), row_bytes);
  }
  return image;
}

absl::StatusOr<sdk::Image> Compress(const cv::Mat& bgr, bool jpeg) {
  std::vector<unsigned char> bytes;
  try {
    const std::vector<int> params =
        jpeg ? std::vector<int>{cv::IMWRITE_JPEG_QUALITY, kJpegQuality}
             : std::vector<int>{cv::IMWRITE_PNG_COMPRESSION, 1};
    if (!cv::imencode(jpeg ? ".jpg" : ".png", bgr, bytes, params)) {
      return absl::InvalidArgumentError("the frame cannot be compressed");
    }
  } catch (const cv::Exception& e) {
    return absl::InvalidArgumentError(e.what());
  }
  sdk::Image image;
  image.encoding = jpeg ? sdk::ImageEncoding::kJpeg : sdk::ImageEncoding::kPng;
  image.bytes.assign(bytes.begin(), bytes.end());
  return image;
}

}  // namespace

absl::StatusOr<EncodingChoice> EncodingFromName(std::string_view name) {
  if (name == "auto") return EncodingChoice::kAuto;
  if (name == "jpeg") return EncodingChoice::kJpeg;
  if (name == "png") return EncodingChoice::kPng;
  if (name == "raw") return EncodingChoice::kRaw;
  return absl::InvalidArgumentError(
      absl::StrCat("encoding \"",
                   base::Abseil(name),
                   "\": expected auto, jpeg, png or raw"));
}

EncodingChoice ResolveEncoding(EncodingChoice choice, std::string_view server) {
  if (choice != EncodingChoice::kAuto) return choice;
  return IsLoopback(server) ? EncodingChoice::kRaw : EncodingChoice::kJpeg;
}

absl::StatusOr<sdk::Image> EncodeFrame(const SourceFrame& frame,
                                       EncodingChoice choice,
                                       bool keep_file_bytes) {
  if (!frame.encoded.empty()) {
    const bool is_jpeg = absl::StartsWith(frame.encoded, "\xFF\xD8");
    const bool as_asked = is_jpeg ? choice == EncodingChoice::kJpeg
                                  : choice == EncodingChoice::kPng;
    if (keep_file_bytes || as_asked) {
      sdk::Image image;
      image.encoding =
          is_jpeg ? sdk::ImageEncoding::kJpeg : sdk::ImageEncoding::kPng;
      image.bytes = frame.encoded;
      return image;
    }
  }
  ASSIGN_OR_RETURN(const cv::Mat bgr, DecodeFrame(frame));
  if (choice == EncodingChoice::kRaw) return RawImage(bgr);
  return Compress(bgr, choice != EncodingChoice::kPng);
}

}  // namespace groundlock::media
