// SPDX-License-Identifier: Apache-2.0
#include "server/image/frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace groundlock::image {
namespace {

using ::testing::HasSubstr;

// Smooth colour waves: JPEG reproduces them to a few gray values.
cv::Mat MakeScene(cv::Size size_px) {
  cv::Mat scene(size_px, CV_8UC3);
  for (int y = 0; y < size_px.height; ++y) {
    for (int x = 0; x < size_px.width; ++x) {
      scene.at<cv::Vec3b>(y, x) =
          cv::Vec3b(cv::saturate_cast<uchar>(128 + 80 * std::sin(x * 0.05)),
                    cv::saturate_cast<uchar>(128 + 80 * std::sin(y * 0.07)),
                    cv::saturate_cast<uchar>(128 + 80 * std::cos(x * 0.04)));
    }
  }
  return scene;
}

std::vector<std::uint8_t> Encode(const std::string& extension,
                                 const cv::Mat& image) {
  std::vector<std::uint8_t> bytes;
  EXPECT_TRUE(
      cv::imencode(extension, image, bytes, {cv::IMWRITE_JPEG_QUALITY, 98}));
  return bytes;
}

EncodedImage Auto(std::span<const std::uint8_t> bytes) {
  return {.bytes = bytes};
}

TEST(DecodeImage, JpegReproducesThePicture) {
  const cv::Mat scene = MakeScene({96, 64});
  const auto frame = DecodeImage(Auto(Encode(".jpg", scene)), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  ASSERT_EQ(frame->bgr.size(), scene.size());
  ASSERT_EQ(frame->size_px(), scene.size());
  // Quality 98 with halved chroma: mean error of about one gray value.
  cv::Mat difference;
  cv::absdiff(frame->bgr, scene, difference);
  const cv::Scalar mean = cv::mean(difference);
  EXPECT_LT(std::max({mean[0], mean[1], mean[2]}), 3.0);
}

TEST(DecodeImage, PngIsExactAndLumaIsRec601) {
  const cv::Mat scene = MakeScene({33, 17});
  const auto frame = DecodeImage(Auto(Encode(".png", scene)), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_EQ(cv::norm(frame->bgr, scene, cv::NORM_INF), 0.0);
  const cv::Vec3b pixel = scene.at<cv::Vec3b>(5, 7);
  const double luma = 0.114 * pixel[0] + 0.587 * pixel[1] + 0.299 * pixel[2];
  EXPECT_NEAR(frame->luma.at<uchar>(5, 7), luma, 1.0);  // rounding
}

TEST(DecodeImage, GrayPngHasEqualChannels) {
  cv::Mat gray;
  cv::cvtColor(MakeScene({20, 10}), gray, cv::COLOR_BGR2GRAY);
  const auto frame = DecodeImage(Auto(Encode(".png", gray)), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_EQ(cv::norm(frame->luma, gray, cv::NORM_INF), 0.0);
  EXPECT_EQ(frame->bgr.channels(), 3);
}

TEST(DecodeImage, RawOrdersChannels) {
  const std::array<std::uint8_t, 6> bytes = {10, 20, 30, 40, 50, 60};
  EncodedImage encoded{Encoding::kRawBgr8, bytes, 2, 1};
  auto frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->bgr.at<cv::Vec3b>(0, 1), cv::Vec3b(40, 50, 60));
  encoded.encoding = Encoding::kRawRgb8;
  frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->bgr.at<cv::Vec3b>(0, 1), cv::Vec3b(60, 50, 40));
  encoded = {Encoding::kRawGray8, bytes, 3, 2};
  frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->luma.at<uchar>(1, 0), 40);
  EXPECT_EQ(frame->bgr.at<cv::Vec3b>(1, 0), cv::Vec3b(40, 40, 40));
}

TEST(DecodeImage, FrameOwnsItsPixels) {
  std::vector<std::uint8_t> bytes(12, 7);
  const auto frame = DecodeImage({Encoding::kRawBgr8, bytes, 2, 2}, {});
  ASSERT_TRUE(frame.ok());
  std::fill(bytes.begin(), bytes.end(), std::uint8_t{0});
  EXPECT_EQ(frame->bgr.at<cv::Vec3b>(1, 1), cv::Vec3b(7, 7, 7));
}

TEST(DecodeImage, RawSizeMustBeExact) {
  const std::vector<std::uint8_t> bytes(11);
  for (const int width_px : {-4, 0, 4}) {
    const auto frame =
        DecodeImage({Encoding::kRawBgr8, bytes, width_px, 1}, {});
    EXPECT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument);
  }
  const auto frame = DecodeImage({Encoding::kRawGray8, bytes, 5, 2}, {});
  EXPECT_THAT(std::string(frame.status().message()),
              HasSubstr("needs 10 bytes, got 11"));
}

TEST(DecodeImage, RejectsEmptyAndUnknown) {
  EXPECT_THAT(std::string(DecodeImage({}, {}).status().message()),
              HasSubstr("empty"));
  const std::string text = "hello, this is no picture";
  const auto frame = DecodeImage(
      Auto({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}),
      {});
  EXPECT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(
      DecodeImage({Encoding::kJpeg, Encode(".png", MakeScene({8, 8}))}, {})
          .status()
          .code(),
      absl::StatusCode::kInvalidArgument);
}

class Truncated : public testing::TestWithParam<const char*> {};

// Wherever the data is cut, the answer is an error, never a part of a picture.
TEST_P(Truncated, IsAnErrorAtEveryLength) {
  const std::vector<std::uint8_t> whole =
      Encode(GetParam(), MakeScene({64, 48}));
  ASSERT_TRUE(DecodeImage(Auto(whole), {}).ok());
  for (std::size_t size = 1; size < whole.size(); ++size) {
    // A JPEG without the two bytes of its end marker has all its pixels, but
    // libjpeg cannot know; a cut inside the marker counts as truncated too.
    const auto frame = DecodeImage(Auto(std::span(whole).first(size)), {});
    ASSERT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument)
        << size << " of " << whole.size() << " bytes";
  }
}

INSTANTIATE_TEST_SUITE_P(Formats, Truncated, testing::Values(".jpg", ".png"));

TEST(DecodeImage, DamagedPngIsAnError) {
  std::vector<std::uint8_t> bytes = Encode(".png", MakeScene({64, 48}));
  bytes[bytes.size() / 2] ^= 0x5A;
  EXPECT_EQ(DecodeImage(Auto(bytes), {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

// 12,000 x 9,000 in the header, no pixels behind it.
TEST(DecodeImage, HugePngHeaderIsRefusedBeforeDecoding) {
  std::vector<std::uint8_t> bytes = Encode(".png", MakeScene({8, 8}));
  const std::array<std::uint8_t, 8> size = {0, 0, 0x2E, 0xE0, 0, 0, 0x23, 0x28};
  std::copy(size.begin(), size.end(), bytes.begin() + 16);
  const auto read = ReadImageSize(Auto(bytes));
  ASSERT_TRUE(read.ok());
  EXPECT_EQ(*read, cv::Size(12'000, 9'000));
  const auto frame = DecodeImage(Auto(bytes), {});
  EXPECT_EQ(frame.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(frame.status().message()), HasSubstr("12000x9000"));
}

TEST(DecodeImage, LimitsHoldForEveryEncoding) {
  const cv::Mat scene = MakeScene({40, 30});
  const std::vector<std::uint8_t> raw(40 * 30);
  const std::vector<std::uint8_t> jpeg = Encode(".jpg", scene);
  const std::vector<std::uint8_t> png = Encode(".png", scene);
  for (const ImageLimits& limits : {ImageLimits{.max_width_px = 39},
                                    ImageLimits{.max_height_px = 29},
                                    ImageLimits{.max_pixels = 1'199}}) {
    for (const EncodedImage& encoded :
         {Auto(jpeg),
          Auto(png),
          EncodedImage{Encoding::kRawGray8, raw, 40, 30}}) {
      EXPECT_EQ(DecodeImage(encoded, limits).status().code(),
                absl::StatusCode::kResourceExhausted);
    }
  }
  EXPECT_TRUE(DecodeImage(Auto(jpeg), {40, 30, 1'200}).ok());
}

TEST(ReadImageSize, NeedsOnlyTheHeader) {
  const std::vector<std::uint8_t> jpeg = Encode(".jpg", MakeScene({70, 50}));
  const auto size = ReadImageSize(Auto(std::span(jpeg).first(jpeg.size() / 2)));
  ASSERT_TRUE(size.ok()) << size.status();
  EXPECT_EQ(*size, cv::Size(70, 50));
}

}  // namespace
}  // namespace groundlock::image
