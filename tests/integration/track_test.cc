// SPDX-License-Identifier: Apache-2.0
// groundlock track: the program and a real server, on videos that are not as
// they should be.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <vector>

#include "tests/integration/command_line.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class Track : public ::testing::Test {
 protected:
  const fs::path& path() const { return command_.path(); }
  // Squares that stand still, in frames of these sizes.
  fs::path Video(const std::vector<cv::Size>& sizes_px) const {
    const fs::path file = path() / "sizes.mjpeg";
    std::ofstream stream(file, std::ios::binary);
    for (const cv::Size& size_px : sizes_px) {
      cv::Mat frame(size_px, CV_8UC3, cv::Scalar::all(90));
      frame(cv::Rect(20, 20, 24, 24)).setTo(cv::Scalar(30, 30, 220));
      std::vector<unsigned char> jpeg;
      cv::imencode(".jpg", frame, jpeg);
      stream.write(reinterpret_cast<const char*>(jpeg.data()),
                   static_cast<std::streamsize>(jpeg.size()));
    }
    return file;
  }

  const TestServer server_;
  const CommandLine command_{server_.address()};
};

TEST_F(Track, TheFrameThatChangesThePicturesSizeIsNamed) {
  const cv::Size large_px(160, 120);
  const cv::Size small_px(120, 80);
  const fs::path video = Video(
      {large_px, large_px, large_px, small_px, small_px, large_px, large_px});
  const fs::path overlay = path() / "overlay.mp4";
  ASSERT_EQ(command_.Run({"track",
                          video,
                          "--no-map",
                          "--init-box",
                          "20,20,24,24",
                          "--overlay",
                          overlay}),
            0)
      << command_.Read("err");
  EXPECT_THAT(command_.Read("err"),
              StartsWith("frame 3: the picture is 120x80 px, those before it "
                         "160x120"));
  EXPECT_THAT(command_.Read("err"), Not(HasSubstr("frame 5:")));
  EXPECT_THAT(command_.Read("out"), HasSubstr("5 processed"));
  EXPECT_THAT(command_.Read("out"), HasSubstr("2 failed"));
  cv::VideoCapture drawn(overlay.string());
  cv::Mat frame;
  int num_frames = 0;
  while (drawn.read(frame)) {
    EXPECT_EQ(frame.size(), large_px) << num_frames;
    ++num_frames;
  }
  EXPECT_EQ(num_frames, 7);
}

TEST_F(Track, AVideoWithoutItsEndIsTold) {
  const fs::path video = path() / "cut.mov";
  {
    cv::VideoWriter writer(video.string(),
                           cv::CAP_FFMPEG,
                           cv::VideoWriter::fourcc('M', 'J', 'P', 'G'),
                           25.0,
                           {160, 120});
    ASSERT_TRUE(writer.isOpened());
    for (int i = 0; i < 10; ++i) {
      writer.write(cv::Mat(120, 160, CV_8UC3, cv::Scalar::all(20 * i)));
    }
  }
  fs::resize_file(video, fs::file_size(video) / 2);
  EXPECT_EQ(command_.Run({"track", video, "--no-map"}), 1);
  EXPECT_THAT(command_.Read("err"),
              HasSubstr("cut.mov: cannot be read as a video: it is no video or "
                        "holds no pictures, or its end is missing"));
}

}  // namespace
}  // namespace groundlock::test
