// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/video_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/decoding/video_file.h"

namespace groundlock::decoding {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
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
              AllOf(HasSubstr("a.mp4: cannot be read as a video"),
                    HasSubstr("its end is missing")));
  EXPECT_EQ(VideoReader::Open(folder() / "none.mp4").status().code(),
            absl::StatusCode::kNotFound);
}

// Of a video that is cut together of two: each frame has its own size, and
// shows what it shows.
TEST_F(VideoReaderTest, FramesHaveTheirOwnSizes) {
  const fs::path path = folder() / "a.mjpeg";
  std::ofstream file(path, std::ios::binary);
  const cv::Size sizes_px[] = {{320, 240}, {160, 200}, {320, 240}};
  for (int i = 0; i < 9; ++i) {
    cv::Mat frame(sizes_px[i / 3], CV_8UC3, cv::Scalar::all(40));
    frame.colRange(0, frame.cols / 2).setTo(cv::Scalar::all(200));
    std::vector<unsigned char> jpeg;
    cv::imencode(".jpg", frame, jpeg);
    file.write(reinterpret_cast<const char*>(jpeg.data()),
               static_cast<std::streamsize>(jpeg.size()));
  }
  file.close();
  auto reader = VideoReader::Open(path);
  ASSERT_TRUE(reader.ok()) << reader.status();
  for (int i = 0; i < 9; ++i) {
    const auto luma = reader->NextLuma();
    ASSERT_TRUE(luma.ok()) << luma.status();
    ASSERT_EQ(luma->size(), sizes_px[i / 3]) << i;
    // JPEG's blocks smear the edge.
    EXPECT_NEAR(cv::mean(luma->colRange(0, luma->cols / 2 - 8))[0], 200.0, 3.0);
    EXPECT_NEAR(
        cv::mean(luma->colRange(luma->cols / 2 + 8, luma->cols))[0], 40.0, 3.0);
  }
  EXPECT_TRUE(reader->NextLuma()->empty());
}

TEST(FilmFocalFromText, ReadsWhatCamerasWrite) {
  EXPECT_EQ(FilmFocalFromText("24.00mm"), 24.0);
  EXPECT_EQ(FilmFocalFromText("50"), 50.0);
  EXPECT_EQ(
      FilmFocalFromText("[iso : 110] [fnum : 280] [focal_len : 240] [a : 1]"),
      24.0);
  EXPECT_EQ(FilmFocalFromText("<font>[iso: 100] [focal_len: 24.00]"), 24.0);
  for (const char* text : {"",
                           "mm",
                           "nan",
                           "inf",
                           "-24",
                           "0",
                           "1e9",
                           "focal_len",
                           "[focal_len : ]",
                           "[focal_len"}) {
    EXPECT_FALSE(FilmFocalFromText(text)) << text;
  }
}

// A DJI drone's subtitles, muxed into the video.
TEST_F(VideoReaderTest, TheCamerasFocalLengthIsRead) {
  const fs::path silent = MakeVideo("silent.mp4", "mp4v");
  EXPECT_FALSE(VideoReader::Open(silent)->film_focal_mm());
  std::ofstream(folder() / "a.srt")
      << "1\n00:00:00,000 --> 00:00:00,400\n"
         "[iso : 110] [shutter : 1/200.0] [focal_len : 280] [latitude: 1.5]\n";
  const fs::path video = folder() / "told.mp4";
  const std::string command = "ffmpeg -v error -i '" + silent.string() +
                              "' -i '" + (folder() / "a.srt").string() +
                              "' -map 0 -map 1 -c:v copy -c:s mov_text '" +
                              video.string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0) << command;
  const auto reader = VideoReader::Open(video);
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_EQ(reader->film_focal_mm(), 28.0);
  EXPECT_EQ(CountFrames(video), kFrames);
  // QuickTime's key, of the whole file.
  const fs::path phone = folder() / "phone.mov";
  const std::string command2 =
      "ffmpeg -v error -i '" + silent.string() +
      "' -c copy -movflags use_metadata_tags -metadata "
      "com.apple.quicktime.camera.focal_length.35mm_equivalent=26.00mm '" +
      phone.string() + "'";
  ASSERT_EQ(std::system(command2.c_str()), 0) << command2;
  const auto of_phone = VideoReader::Open(phone);
  ASSERT_TRUE(of_phone.ok()) << of_phone.status();
  EXPECT_EQ(of_phone->film_focal_mm(), 26.0);
  EXPECT_EQ(CountFrames(phone), kFrames);
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
