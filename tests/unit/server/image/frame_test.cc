// SPDX-License-Identifier: Apache-2.0
#include "server/image/frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <turbojpeg.h>

#include <array>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <ostream>
#include <string>
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
  ASSERT_EQ(frame->Bgr().size(), scene.size());
  ASSERT_EQ(frame->size_px(), scene.size());
  // Quality 98 with halved chroma: mean error of about one gray value.
  cv::Mat difference;
  cv::absdiff(frame->Bgr(), scene, difference);
  const cv::Scalar mean = cv::mean(difference);
  EXPECT_LT(std::max({mean[0], mean[1], mean[2]}), 3.0);
}

TEST(DecodeImage, PngIsExactAndLumaIsRec601) {
  const cv::Mat scene = MakeScene({33, 17});
  const auto frame = DecodeImage(Auto(Encode(".png", scene)), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_EQ(cv::norm(frame->Bgr(), scene, cv::NORM_INF), 0.0);
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
  EXPECT_EQ(frame->Bgr().channels(), 3);
}

TEST(DecodeImage, RawOrdersChannels) {
  const std::array<std::uint8_t, 6> bytes = {10, 20, 30, 40, 50, 60};
  EncodedImage encoded{Encoding::kRawBgr8, bytes, 2, 1};
  auto frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->Bgr().at<cv::Vec3b>(0, 1), cv::Vec3b(40, 50, 60));
  encoded.encoding = Encoding::kRawRgb8;
  frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->Bgr().at<cv::Vec3b>(0, 1), cv::Vec3b(60, 50, 40));
  encoded = {Encoding::kRawGray8, bytes, 3, 2};
  frame = DecodeImage(encoded, {});
  ASSERT_TRUE(frame.ok());
  EXPECT_EQ(frame->luma.at<uchar>(1, 0), 40);
  EXPECT_EQ(frame->Bgr().at<cv::Vec3b>(1, 0), cv::Vec3b(40, 40, 40));
}

TEST(DecodeImage, FrameOwnsItsPixels) {
  std::vector<std::uint8_t> bytes(12, 7);
  const auto frame = DecodeImage({Encoding::kRawBgr8, bytes, 2, 2}, {});
  ASSERT_TRUE(frame.ok());
  std::fill(bytes.begin(), bytes.end(), std::uint8_t{0});
  EXPECT_EQ(frame->Bgr().at<cv::Vec3b>(1, 1), cv::Vec3b(7, 7, 7));
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

// libjpeg's own pixels; encoded with the subsampling asked for.
struct JpegCase {
  const char* name;
  int subsampling;  // TJSAMP_*
  int pixel_format;
  int flags;
};
void PrintTo(const JpegCase& jpeg, std::ostream* out) { *out << jpeg.name; }

class JpegOfEveryMake : public testing::TestWithParam<JpegCase> {};

std::vector<std::uint8_t> EncodeJpeg(const cv::Mat& bgr, const JpegCase& make) {
  tjhandle handle = tjInitCompress();
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  EXPECT_EQ(tjCompress2(handle,
                        bgr.data,
                        bgr.cols,
                        static_cast<int>(bgr.step[0]),
                        bgr.rows,
                        make.pixel_format,
                        &bytes,
                        &size,
                        make.subsampling,
                        97,
                        make.flags),
            0);
  std::vector<std::uint8_t> out(bytes, bytes + size);
  tjFree(bytes);
  tjDestroy(handle);
  return out;
}

// Odd sizes, so that the last chroma samples are shared with nothing.
TEST_P(JpegOfEveryMake, GivesLumaAndColour) {
  const cv::Mat scene = MakeScene({75, 53});
  const std::vector<std::uint8_t> bytes = EncodeJpeg(scene, GetParam());
  const auto frame = DecodeImage(Auto(bytes), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  ASSERT_EQ(frame->luma.size(), scene.size());
  cv::Mat gray;
  cv::cvtColor(scene, gray, cv::COLOR_BGR2GRAY);
  // Two gray values: rounding, and quantisation at quality 97.
  EXPECT_LT(cv::norm(frame->luma, gray, cv::NORM_L1) / gray.total(), 2.0);
  const cv::Mat& bgr = frame->Bgr();
  ASSERT_EQ(bgr.type(), CV_8UC3);
  cv::Mat expected = scene;
  if (GetParam().subsampling == TJSAMP_GRAY) {
    cv::cvtColor(gray, expected, cv::COLOR_GRAY2BGR);
  }
  // Chroma that four pixels in a row share blurs the waves by more.
  EXPECT_LT(cv::norm(bgr, expected, cv::NORM_L1) / (3.0 * gray.total()), 4.0);
}

// What is converted for one region is what converting all of it gives.
TEST_P(JpegOfEveryMake, RegionsFitTogether) {
  const std::vector<std::uint8_t> bytes =
      EncodeJpeg(MakeScene({75, 53}), GetParam());
  const cv::Mat whole = DecodeImage(Auto(bytes), {})->Bgr().clone();
  const auto frame = DecodeImage(Auto(bytes), {});
  for (const cv::Rect& region : {cv::Rect(10, 7, 21, 13),
                                 cv::Rect(-5, -5, 9, 9),
                                 cv::Rect(70, 50, 40, 40),
                                 cv::Rect(31, 20, 1, 1)}) {
    const cv::Rect inside = region & cv::Rect(0, 0, 75, 53);
    // Interpolation rounds in fixed point.
    EXPECT_LE(cv::norm(frame->Bgr(region)(inside), whole(inside), cv::NORM_INF),
              1.0);
  }
  EXPECT_EQ(cv::norm(frame->Bgr()(cv::Rect(40, 30, 30, 15)),
                     whole(cv::Rect(40, 30, 30, 15)),
                     cv::NORM_INF),
            0.0);
}

// A halved picture, whole or in part, is the picture halved.
TEST_P(JpegOfEveryMake, HalvedIsTheMeanOfWhatItCovers) {
  const std::vector<std::uint8_t> bytes =
      EncodeJpeg(MakeScene({175, 153}), GetParam());
  const cv::Mat whole = DecodeImage(Auto(bytes), {})->Bgr().clone();
  for (int halvings = 1; halvings <= ColourPicture::kMaxHalvings; ++halvings) {
    const auto frame = DecodeImage(Auto(bytes), {});
    const cv::Size size(175 >> halvings, 153 >> halvings);
    cv::Mat expected;
    cv::resize(whole(cv::Rect(
                   cv::Point(),
                   cv::Size(size.width << halvings, size.height << halvings))),
               expected,
               size,
               0.0,
               0.0,
               cv::INTER_AREA);
    const cv::Rect part(3, 2, size.width / 2, size.height / 3);
    // Chroma that pixels share is not interpolated between them first.
    EXPECT_LT(
        cv::norm(
            frame->Bgr(part, halvings)(part), expected(part), cv::NORM_L1) /
            (3.0 * part.area()),
        2.0);
    const cv::Mat& all = frame->Bgr(cv::Rect(cv::Point(), size), halvings);
    ASSERT_EQ(all.size(), size);
    EXPECT_LT(cv::norm(all, expected, cv::NORM_L1) / (3.0 * size.area()), 2.0);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Makes,
    JpegOfEveryMake,
    testing::Values(
        JpegCase{"420", TJSAMP_420, TJPF_BGR, 0},
        JpegCase{"422", TJSAMP_422, TJPF_BGR, 0},
        JpegCase{"444", TJSAMP_444, TJPF_BGR, 0},
        JpegCase{"440", TJSAMP_440, TJPF_BGR, 0},
        JpegCase{"411", TJSAMP_411, TJPF_BGR, 0},
        JpegCase{"gray", TJSAMP_GRAY, TJPF_BGR, 0},
        JpegCase{"progressive", TJSAMP_420, TJPF_BGR, TJFLAG_PROGRESSIVE}),
    [](const auto& test) { return std::string("Make") + test.param.name; });

// Luma 3 x 1, chroma 1 x 1: allowed, but made by no camera. The factors are in
// the frame header (SOF0), after length, precision, size and the count.
TEST(DecodeImage, UnusualSubsamplingIsDecodedOrRefused) {
  const cv::Mat scene = MakeScene({48, 32});
  std::vector<std::uint8_t> bytes =
      EncodeJpeg(scene, {"420", TJSAMP_420, TJPF_BGR, 0});
  for (std::size_t i = 0; i + 12 < bytes.size(); ++i) {
    if (bytes[i] == 0xFF && bytes[i + 1] == 0xC0) bytes[i + 11] = 0x31;
  }
  const auto size = ReadImageSize(Auto(bytes));
  ASSERT_TRUE(size.ok()) << size.status();
  EXPECT_EQ(*size, scene.size());
  const auto frame = DecodeImage(Auto(bytes), {});
  if (frame.ok()) {
    EXPECT_EQ(frame->size_px(), scene.size());
  } else {
    EXPECT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument);
  }
}

TEST(DecodeImage, CmykJpegIsRefused) {
  const cv::Mat cmyk(16, 16, CV_8UC4, cv::Scalar(10, 20, 30, 40));
  const std::vector<std::uint8_t> bytes =
      EncodeJpeg(cmyk, {"cmyk", TJSAMP_444, TJPF_CMYK, 0});
  const auto frame = DecodeImage(Auto(bytes), {});
  EXPECT_EQ(frame.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(frame.status().message()), HasSubstr("CMYK"));
}

// Viewers would show this one turned; a camera's intrinsics belong to the
// pixels as they lie.
TEST(DecodeImage, OrientationTagsAreNotFollowed) {
  const std::vector<std::uint8_t> plain = Encode(".jpg", MakeScene({64, 48}));
  const std::vector<std::uint8_t> exif = {
      0xFF, 0xE1, 0, 34, 'E', 'x', 'i', 'f', 0, 0,    'M', 'M',
      0,    42,   0, 0,  0,   8,   0,   1,   1, 0x12, 0,   3,
      0,    0,    0, 1,  0,   6,   0,   0,   0, 0,    0,   0};
  std::vector<std::uint8_t> turned = plain;
  turned.insert(turned.begin() + 2, exif.begin(), exif.end());
  const auto frame = DecodeImage(Auto(turned), {});
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_EQ(
      cv::norm(frame->Bgr(), DecodeImage(Auto(plain), {})->Bgr(), cv::NORM_INF),
      0.0);
}

TEST(Frame, PixelsAskedForStayWhenOthersAre) {
  const auto frame = DecodeImage(
      Auto(EncodeJpeg(cv::Mat(64, 64, CV_8UC3, cv::Scalar(90, 120, 150)),
                      {"420", TJSAMP_420, TJPF_BGR, 0})),
      {});
  ASSERT_TRUE(frame.ok());
  const cv::Rect first(8, 8, 16, 16);
  const cv::Rect second(40, 30, 20, 20);
  const cv::Mat before = frame->Bgr(first)(first).clone();
  const cv::Mat& bgr = frame->Bgr(second);
  EXPECT_EQ(bgr.size(), cv::Size(64, 64));
  EXPECT_EQ(cv::norm(bgr(first), before, cv::NORM_INF), 0.0);
  for (const cv::Point at : {first.tl(), second.tl(), cv::Point(59, 49)}) {
    const auto pixel = bgr.at<cv::Vec3b>(at);
    EXPECT_NEAR(pixel[0], 90, 4) << at;
    EXPECT_NEAR(pixel[1], 120, 4) << at;
    EXPECT_NEAR(pixel[2], 150, 4) << at;
  }
}

TEST(Frame, PyramidIsBuiltOnceFromMeansOfFourWithinMirrors) {
  const Frame frame = Frame::FromBgr(MakeScene({163, 121}));
  const auto pyramid = frame.Pyramid();
  EXPECT_EQ(pyramid, frame.Pyramid());
  EXPECT_EQ(pyramid, Frame(frame).Pyramid());
  ASSERT_EQ(pyramid->levels.size(), 4U);  // 15 rows, and the next has 7
  EXPECT_EQ(cv::norm(pyramid->levels[0], frame.luma, cv::NORM_INF), 0.0);
  constexpr int kBorder = LumaPyramid::kWindowPx;
  for (std::size_t i = 0; i < pyramid->levels.size(); ++i) {
    const cv::Mat& level = pyramid->levels[i];
    cv::Mat bordered = level;
    bordered.adjustROI(kBorder, kBorder, kBorder, kBorder);
    cv::Mat expected;
    cv::copyMakeBorder(level,
                       expected,
                       kBorder,
                       kBorder,
                       kBorder,
                       kBorder,
                       cv::BORDER_REFLECT_101 | cv::BORDER_ISOLATED);
    ASSERT_EQ(bordered.size(), expected.size());
    EXPECT_EQ(cv::norm(bordered, expected, cv::NORM_INF), 0.0) << i;
    if (i == 0) continue;
    const cv::Mat& finer = pyramid->levels[i - 1];
    ASSERT_EQ(level.size(), cv::Size(finer.cols / 2, finer.rows / 2));
    for (int y = 0; y < level.rows; ++y) {
      for (int x = 0; x < level.cols; ++x) {
        const int sum = finer.at<unsigned char>(2 * y, 2 * x) +
                        finer.at<unsigned char>(2 * y, 2 * x + 1) +
                        finer.at<unsigned char>(2 * y + 1, 2 * x) +
                        finer.at<unsigned char>(2 * y + 1, 2 * x + 1);
        ASSERT_NEAR(level.at<unsigned char>(y, x), 0.25 * sum, 0.51);
      }
    }
  }
}

TEST(ReadImageSize, NeedsOnlyTheHeader) {
  const std::vector<std::uint8_t> jpeg = Encode(".jpg", MakeScene({70, 50}));
  const auto size = ReadImageSize(Auto(std::span(jpeg).first(jpeg.size() / 2)));
  ASSERT_TRUE(size.ok()) << size.status();
  EXPECT_EQ(*size, cv::Size(70, 50));
}

}  // namespace
}  // namespace groundlock::image
