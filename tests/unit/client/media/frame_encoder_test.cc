// SPDX-License-Identifier: Apache-2.0
#include "client/media/frame_encoder.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

namespace groundlock::media {
namespace {

SourceFrame Pixels() {
  SourceFrame frame;
  frame.bgr = cv::Mat(4, 6, CV_8UC3, cv::Scalar(10, 20, 30));
  frame.bgr.at<cv::Vec3b>(3, 5) = {1, 2, 3};
  return frame;
}

SourceFrame PngFile() {
  std::vector<unsigned char> bytes;
  EXPECT_TRUE(cv::imencode(".png", Pixels().bgr, bytes));
  SourceFrame frame;
  frame.encoded.assign(bytes.begin(), bytes.end());
  return frame;
}

TEST(ResolveEncoding, SendsRawPixelsOnlyToThisMachine) {
  for (const char* server :
       {"127.0.0.1:50551", "localhost:1", "[::1]:50551", "127.1.2.3:9"}) {
    EXPECT_EQ(ResolveEncoding(EncodingChoice::kAuto, server),
              EncodingChoice::kRaw)
        << server;
  }
  for (const char* server :
       {"10.0.0.1:50551", "localhost.example.org:1", "[::2]:1"}) {
    EXPECT_EQ(ResolveEncoding(EncodingChoice::kAuto, server),
              EncodingChoice::kJpeg)
        << server;
  }
  EXPECT_EQ(ResolveEncoding(EncodingChoice::kPng, "127.0.0.1:1"),
            EncodingChoice::kPng);
}

TEST(EncodingFromName, RefusesUnknownNames) {
  EXPECT_EQ(*EncodingFromName("jpeg"), EncodingChoice::kJpeg);
  EXPECT_FALSE(EncodingFromName("webp").ok());
}

TEST(EncodeFrame, PacksRawRowsWithoutPadding) {
  SourceFrame frame = Pixels();
  // A view into a wider image has padded rows.
  cv::Mat wide(4, 10, CV_8UC3, cv::Scalar::all(255));
  frame.bgr.copyTo(wide.colRange(0, 6));
  frame.bgr = wide.colRange(0, 6);
  const auto image = EncodeFrame(frame, EncodingChoice::kRaw, true);
  ASSERT_TRUE(image.ok()) << image.status();
  EXPECT_EQ(image->encoding, sdk::ImageEncoding::kRawBgr8);
  EXPECT_EQ(image->width_px, 6);
  EXPECT_EQ(image->height_px, 4);
  ASSERT_EQ(image->bytes.size(), 6U * 4U * 3U);
  EXPECT_EQ(image->bytes.substr(0, 3), std::string("\x0A\x14\x1E"));
  EXPECT_EQ(image->bytes.substr(69, 3), std::string("\x01\x02\x03"));
}

TEST(EncodeFrame, KeepsAFilesBytesUnlessAskedOtherwise) {
  const SourceFrame file = PngFile();
  const auto kept = EncodeFrame(file, EncodingChoice::kRaw, true);
  ASSERT_TRUE(kept.ok());
  EXPECT_EQ(kept->encoding, sdk::ImageEncoding::kPng);
  EXPECT_EQ(kept->bytes, file.encoded);
  const auto raw = EncodeFrame(file, EncodingChoice::kRaw, false);
  ASSERT_TRUE(raw.ok());
  EXPECT_EQ(raw->encoding, sdk::ImageEncoding::kRawBgr8);
  const auto jpeg = EncodeFrame(file, EncodingChoice::kJpeg, false);
  ASSERT_TRUE(jpeg.ok());
  EXPECT_EQ(jpeg->encoding, sdk::ImageEncoding::kJpeg);
  EXPECT_EQ(jpeg->bytes.substr(0, 2), "\xFF\xD8");
}

TEST(EncodeFrame, ReportsWhatCannotBeDecoded) {
  SourceFrame frame;
  frame.encoded = "\xFF\xD8\xFF and nothing more";
  EXPECT_EQ(EncodeFrame(frame, EncodingChoice::kRaw, false).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace groundlock::media
