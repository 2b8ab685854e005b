// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/video_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string>

#include "map_store/base/file.h"

namespace groundlock::decoding {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr int kFrames = 12;

class VideoReaderTest : public ::testing::Test {
 protected:
  fs::path folder() const { return directory_.path(); }
  fs::path MakeVideo(const std::string& name, const char* codec) const {
    const fs::path path = folder() / name;
    cv::VideoWriter writer(
        path.string(),
        cv::CAP_FFMPEG,
        cv::VideoWriter::fourcc(codec[0], codec[1], codec[2], codec[3]),
        25.0,
        cv::Size(320, 240));
    EXPECT_TRUE(writer.isOpened());
    cv::Mat frame(240, 320, CV_8UC3);
    cv::RNG random(3);
    random.fill(frame, cv::RNG::UNIFORM, 0, 256);
    cv::GaussianBlur(frame, frame, cv::Size(9, 9), 3.0);
    for (int i = 0; i < kFrames; ++i) {
      cv::Mat moved;
      cv::warpAffine(frame,
                     moved,
                     cv::Matx23d(1.0, 0.0, 3.0 * i, 0.0, 1.0, i),
                     frame.size(),
                     cv::INTER_LINEAR,
                     cv::BORDER_REFLECT);
      writer.write(moved);
    }
    return path;
  }

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

int CountFrames(const fs::path& path) {
  auto reader = VideoReader::Open(path);
  if (!reader.ok()) return -1;
  int count = 0;
  for (;; ++count) {
    const auto luma = reader->NextLuma();
    if (!luma.ok() || luma->empty()) break;
  }
  return count;
}

TEST_F(VideoReaderTest, GivesTheFramesThatDecodingHereGives) {
  for (const auto& [name, codec] :
       {std::pair{"a.mp4", "mp4v"}, std::pair{"a.avi", "MJPG"}}) {
    const fs::path path = MakeVideo(name, codec);
    cv::VideoCapture capture(path.string(), cv::CAP_FFMPEG);
    auto reader = VideoReader::Open(path);
    ASSERT_TRUE(reader.ok()) << reader.status();
    EXPECT_EQ(reader->expected_frames(), kFrames);
    cv::Mat frame;
    for (int i = 0; i < kFrames; ++i) {
      ASSERT_TRUE(capture.read(frame));
      cv::Mat expected;
      cv::cvtColor(frame, expected, cv::COLOR_BGR2GRAY);
      const auto luma = reader->NextLuma();
      ASSERT_TRUE(luma.ok()) << luma.status();
      ASSERT_EQ(luma->size(), expected.size());
      EXPECT_EQ(cv::norm(*luma, expected, cv::NORM_INF), 0.0);
      const auto colour = reader->Colour();
      ASSERT_TRUE(colour.ok()) << colour.status();
      EXPECT_EQ(cv::norm(*colour, frame, cv::NORM_INF), 0.0);
    }
    const auto end = reader->NextLuma();
    ASSERT_TRUE(end.ok()) << end.status();
    EXPECT_TRUE(end->empty());
  }
}

TEST_F(VideoReaderTest, WhatIsNoVideoIsToldByName) {
  std::ofstream(folder() / "a.mp4") << "no video";
  const auto none = VideoReader::Open(folder() / "a.mp4");
  EXPECT_EQ(none.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(none.status().message()),
              HasSubstr("a.mp4: cannot be read as a video"));
  EXPECT_EQ(VideoReader::Open(folder() / "none.mp4").status().code(),
            absl::StatusCode::kNotFound);
}

// A playlist is a video whose frames lie in other files: of other users of the
// server, say. Decoded without the cage it shows them, which is checked first.
TEST_F(VideoReaderTest, APlaylistDoesNotShowOtherFiles) {
  const fs::path secret = MakeVideo("secret.avi", "MJPG");
  const fs::path playlist = folder() / "playlist.mp4";
  std::ofstream(playlist) << "#EXTM3U\n#EXT-X-TARGETDURATION:5\n"
                             "#EXTINF:5.0,\n"
                          << secret.string() << "\n#EXT-X-ENDLIST\n";
  cv::VideoCapture outside(playlist.string(), cv::CAP_FFMPEG);
  cv::Mat frame;
  EXPECT_TRUE(outside.read(frame)) << "FFmpeg has become careful by itself";
  EXPECT_EQ(CountFrames(secret), kFrames);
  EXPECT_LE(CountFrames(playlist), 0);
}

}  // namespace
}  // namespace groundlock::decoding
