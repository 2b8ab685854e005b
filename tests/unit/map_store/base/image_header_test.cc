// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/image_header.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

namespace groundlock::base {
namespace {

using ::testing::HasSubstr;

std::string Encoded(const char* extension, int width, int height) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(extension, cv::Mat(height, width, CV_8UC3, {1, 2, 3}), bytes);
  return {bytes.begin(), bytes.end()};
}

// A PNG's first bytes, and no pixels.
std::string PngOf(std::uint32_t width, std::uint32_t height) {
  std::string bytes("\x89PNG\r\n\x1A\n\0\0\0\x0DIHDR", 16);
  for (const std::uint32_t side : {width, height}) {
    for (int shift = 24; shift >= 0; shift -= 8) {
      bytes += static_cast<char>(side >> shift & 0xFF);
    }
  }
  return bytes + std::string("\x08\x02\0\0\0", 5);
}

TEST(ImageHeader, SaysWhatOpenCvWouldDecode) {
  for (const char* extension :
       {".jpg", ".png", ".bmp", ".tif", ".webp", ".ppm"}) {
    for (const auto& [width, height] :
         {std::pair(1, 1), {640, 480}, {3, 500}, {1'021, 2}}) {
      const auto header = ReadImageHeader(Encoded(extension, width, height));
      ASSERT_TRUE(header.has_value()) << extension;
      EXPECT_EQ(header->width_px, static_cast<unsigned>(width)) << extension;
      EXPECT_EQ(header->height_px, static_cast<unsigned>(height)) << extension;
    }
  }
}

TEST(ImageHeader, ACutHeaderIsNone) {
  for (const char* extension :
       {".jpg", ".png", ".bmp", ".tif", ".webp", ".ppm"}) {
    const std::string whole = Encoded(extension, 640, 480);
    for (std::size_t length = 0; length < 16; ++length) {
      const auto header = ReadImageHeader(whole.substr(0, length));
      if (!header.has_value()) continue;
      // A PPM's is over with the second number.
      EXPECT_EQ(extension, std::string(".ppm")) << length << " bytes";
      EXPECT_EQ(header->width_px, 640U);
      EXPECT_EQ(header->height_px, 480U);
    }
  }
  EXPECT_FALSE(ReadImageHeader("GIF89a").has_value());
  EXPECT_FALSE(ReadImageHeader("").has_value());
}

TEST(ImageHeader, FewBytesThatClaimManyPixelsAreRefused) {
  EXPECT_TRUE(CheckImageSize(PngOf(11'648, 8'736), kMaxPhotoPixels).ok());
  const absl::Status huge =
      CheckImageSize(PngOf(32'768, 32'768), kMaxPhotoPixels);
  EXPECT_TRUE(absl::IsResourceExhausted(huge));
  EXPECT_THAT(huge.ToString(), HasSubstr("32768x32768"));
  EXPECT_TRUE(absl::IsResourceExhausted(
      CheckImageSize(PngOf(0xFFFFFFFF, 0xFFFFFFFF), kMaxPhotoPixels)));
  EXPECT_TRUE(
      absl::IsInvalidArgument(CheckImageSize(PngOf(0, 1), kMaxPhotoPixels)));
}

// What decoders skip is skipped here: else a small size shown to us would hide
// a large one.
TEST(ImageHeader, NothingHidesTheSizeThatCounts) {
  const std::string frame("\xFF\xC0\x00\x0B\x08\x01\x02\x03\x04", 9);
  const std::string standalone("\xFF\xD0\xFF\x01\xFF\xFF", 6);
  const auto jpeg = ReadImageHeader("\xFF\xD8" + standalone + frame);
  ASSERT_TRUE(jpeg.has_value());
  EXPECT_EQ(jpeg->width_px, 0x304U);
  EXPECT_EQ(jpeg->height_px, 0x102U);
  const auto ppm = ReadImageHeader("P6\n# 1 1\r700 500\n255\n");
  ASSERT_TRUE(ppm.has_value());
  EXPECT_EQ(ppm->width_px, 700U);
  // 2x2 to one who takes "#8" for a comment, 2x8 to OpenCV.
  EXPECT_FALSE(ReadImageHeader("P4\n2#8\n#\n#\n2#8\n#\n#\n").has_value());
  // Twice the same entry: the larger one counts.
  std::string tiff("II*\0\x08\0\0\0\x03\0", 10);
  for (const char* entry : {"\x00\x01\x04\0\x01\0\0\0\x02\x03\0\0",
                            "\x00\x01\x04\0\x01\0\0\0\x01\0\0\0",
                            "\x01\x01\x04\0\x01\0\0\0\x05\0\0\0"}) {
    tiff += std::string(entry, 12);
  }
  const auto entries = ReadImageHeader(tiff);
  ASSERT_TRUE(entries.has_value());
  EXPECT_EQ(entries->width_px, 0x302U);
  EXPECT_EQ(entries->height_px, 5U);
}

}  // namespace
}  // namespace groundlock::base
