// SPDX-License-Identifier: Apache-2.0
#include "client/media/video_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <string>

#include "map_store/base/file.h"

namespace groundlock::media {
namespace {

using std::chrono::nanoseconds;
using ::testing::HasSubstr;
using ::testing::Not;

class VideoSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto directory = base::TemporaryDirectory::Create(
        std::filesystem::temp_directory_path());
    ASSERT_TRUE(directory.ok()) << directory.status();
    directory_ =
        std::make_unique<base::TemporaryDirectory>(*std::move(directory));
  }
  const std::filesystem::path& path() const { return directory_->path(); }

  // Frames of one grey level each, 8 levels apart, so that a decoded frame
  // tells its number whatever the codec does to it.
  std::string WriteVideo(int num_frames,
                         double fps,
                         const std::string& name = "video.avi") {
    const std::string file = (path() / name).string();
    cv::VideoWriter writer(file,
                           cv::CAP_FFMPEG,
                           cv::VideoWriter::fourcc('M', 'J', 'P', 'G'),
                           fps,
                           cv::Size(64, 48));
    EXPECT_TRUE(writer.isOpened());
    for (int i = 0; i < num_frames; ++i) {
      writer.write(cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(8 + 8 * i)));
    }
    return file;
  }

  std::unique_ptr<base::TemporaryDirectory> directory_;
};

int FrameNumberIn(const cv::Mat& bgr) {
  return static_cast<int>(std::lround((cv::mean(bgr)[0] - 8.0) / 8.0));
}

TEST_F(VideoSourceTest, ReadsAVideoWithItsTimes) {
  const auto source = OpenVideoSource(WriteVideo(10, 20.0), {});
  ASSERT_TRUE(source.ok()) << source.status();
  EXPECT_EQ((*source)->num_frames(), 10U);
  EXPECT_FALSE((*source)->live());
  for (int i = 0; i < 10; ++i) {
    const auto frame = (*source)->Next();
    ASSERT_TRUE(frame.ok()) << frame.status();
    ASSERT_TRUE(frame->has_value());
    EXPECT_EQ((*frame)->number, static_cast<std::uint64_t>(i));
    EXPECT_EQ((*frame)->bgr.size(), cv::Size(64, 48));
    EXPECT_EQ(FrameNumberIn((*frame)->bgr), i);
    // 50 ms a frame; the container's clock has at best microseconds.
    EXPECT_NEAR((*frame)->capture_time.count() * 1e-6, 50.0 * i, 0.01);
  }
  const auto end = (*source)->Next();
  ASSERT_TRUE(end.ok());
  EXPECT_FALSE(end->has_value());
}

TEST_F(VideoSourceTest, KeepsNumbersAndTimesInARange) {
  VideoSourceOptions options;
  options.frames = {3, 6};
  const auto source = OpenVideoSource(WriteVideo(10, 20.0), options);
  ASSERT_TRUE(source.ok()) << source.status();
  EXPECT_EQ((*source)->num_frames(), 3U);
  std::vector<std::uint64_t> numbers;
  while (true) {
    const auto frame = (*source)->Next();
    ASSERT_TRUE(frame.ok());
    if (!frame->has_value()) break;
    numbers.push_back((*frame)->number);
    EXPECT_EQ(FrameNumberIn((*frame)->bgr), static_cast<int>((*frame)->number));
    EXPECT_NEAR((*frame)->capture_time.count() * 1e-6,
                50.0 * static_cast<double>((*frame)->number),
                0.01);
  }
  EXPECT_THAT(numbers, ::testing::ElementsAre(3, 4, 5));
}

TEST_F(VideoSourceTest, ReadsAFolderInOrderAndKeepsItsBytes) {
  for (int i : {2, 0, 1}) {
    const cv::Mat image(48, 64, CV_8UC3, cv::Scalar::all(8 + 8 * i));
    ASSERT_TRUE(cv::imwrite(
        (path() / ("frame_000" + std::to_string(i) + ".png")).string(), image));
  }
  std::ofstream(path() / "notes.txt") << "no image";
  VideoSourceOptions options;
  options.fps = 10.0;
  const auto source = OpenVideoSource(path().string(), options);
  ASSERT_TRUE(source.ok()) << source.status();
  EXPECT_EQ((*source)->num_frames(), 3U);
  for (int i = 0; i < 3; ++i) {
    const auto frame = (*source)->Next();
    ASSERT_TRUE(frame.ok() && frame->has_value());
    EXPECT_EQ((*frame)->number, static_cast<std::uint64_t>(i));
    EXPECT_EQ((*frame)->capture_time, nanoseconds(i * 100'000'000));
    EXPECT_TRUE((*frame)->bgr.empty());
    const auto on_disk = base::ReadFile(path() / (*frame)->name, 1 << 20);
    ASSERT_TRUE(on_disk.ok());
    EXPECT_EQ((*frame)->encoded, *on_disk);
    const auto bgr = DecodeFrame(**frame);
    ASSERT_TRUE(bgr.ok()) << bgr.status();
    EXPECT_EQ(FrameNumberIn(*bgr), i);
  }
}

TEST_F(VideoSourceTest, DecodesWhatTheServerDoesNotRead) {
  const cv::Mat image(48, 64, CV_8UC3, cv::Scalar::all(80));
  ASSERT_TRUE(cv::imwrite((path() / "a.bmp").string(), image));
  const auto frame = ReadImage(path() / "a.bmp");
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_TRUE(frame->encoded.empty());
  EXPECT_EQ(frame->bgr.size(), image.size());
}

TEST_F(VideoSourceTest, SaysWhatIsWrong) {
  const std::string absent = (path() / "absent.mp4").string();
  EXPECT_EQ(OpenVideoSource(absent, {}).status().code(),
            absl::StatusCode::kNotFound);
  std::ofstream(path() / "text.mp4") << "this is no video";
  const absl::Status text =
      OpenVideoSource((path() / "text.mp4").string(), {}).status();
  EXPECT_EQ(text.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(text.message()),
              HasSubstr("text.mp4: cannot be read as a video"));
  // Its index is written last.
  const std::string cut = WriteVideo(10, 20.0, "cut.mov");
  std::filesystem::resize_file(cut, std::filesystem::file_size(cut) / 2);
  const absl::Status without_end = OpenVideoSource(cut, {}).status();
  EXPECT_EQ(without_end.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(without_end.message()),
              HasSubstr("its end is missing because a recording or a copy was "
                        "interrupted"));
  std::filesystem::create_directory(path() / "empty");
  EXPECT_THAT(
      std::string(
          OpenVideoSource((path() / "empty").string(), {}).status().message()),
      HasSubstr("no images"));
  VideoSourceOptions options;
  options.fps = 0.0;
  EXPECT_THAT(
      std::string(OpenVideoSource(path().string(), options).status().message()),
      HasSubstr("fps"));
  std::ofstream(path() / "broken.bmp") << "BM but no bitmap";
  EXPECT_FALSE(ReadImage(path() / "broken.bmp").ok());
}

// A camera's address is shown to viewers and logged; its password is not.
TEST(ShownInput, HidesUserPasswordAndQuery) {
  EXPECT_EQ(ShownInput("rtsp://camera.example:554/live"),
            "rtsp://camera.example:554/live");
  EXPECT_EQ(ShownInput("rtsp://user:secret@camera/live"),
            "rtsp://...@camera/live");
  EXPECT_EQ(ShownInput("rtsp://user@camera"), "rtsp://...@camera");
  EXPECT_EQ(ShownInput("rtsp://user:se@cr/et@camera/live"),
            "rtsp://...@camera/live");
  EXPECT_EQ(ShownInput("http://camera/video@2x?user=a&password=secret"),
            "http://camera/video@2x?...");
  EXPECT_EQ(ShownInput("/videos/a@b.mp4"), "/videos/a@b.mp4");
}

TEST(ShownInput, NoMessageOfOpeningHoldsThePassword) {
  // Nothing listens on port 1.
  const auto source =
      OpenVideoSource("rtsp://user:secret@127.0.0.1:1/live?token=secret", {});
  ASSERT_FALSE(source.ok());
  EXPECT_THAT(source.status().ToString(), HasSubstr("127.0.0.1:1/live"));
  EXPECT_THAT(source.status().ToString(), Not(HasSubstr("secret")));
  EXPECT_THAT(source.status().ToString(), Not(HasSubstr("user")));
}

}  // namespace
}  // namespace groundlock::media
