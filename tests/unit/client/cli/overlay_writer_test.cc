// SPDX-License-Identifier: Apache-2.0
#include "client/cli/overlay_writer.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "client/media/video_source.h"
#include "map_store/base/file.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;

class OverlayWriterTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto directory =
        base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(directory.ok()) << directory.status();
    directory_ =
        std::make_unique<base::TemporaryDirectory>(*std::move(directory));
  }
  int NumFiles() const {
    return static_cast<int>(std::distance(
        fs::directory_iterator(directory_->path()), fs::directory_iterator()));
  }
  fs::path path(const char* name) const { return directory_->path() / name; }

  std::unique_ptr<base::TemporaryDirectory> directory_;
};

TEST_F(OverlayWriterTest, WritesAPlayableVideoWithTimes) {
  // Odd sizes too: the last column and row are left out.
  auto writer = OverlayWriter::Create(path("o.mp4"), cv::Size(321, 241), 20.0);
  ASSERT_TRUE(writer.ok()) << writer.status();
  // A gap after the second frame, as dropped frames leave it.
  const int times_ms[] = {1000, 1050, 1200, 1250, 1300, 1350, 1400, 1450};
  for (int i = 0; i < 8; ++i) {
    cv::Scalar colour = cv::Scalar::all(20);
    colour[i % 3] = 220;
    const cv::Mat frame(241, 321, CV_8UC3, colour);
    ASSERT_TRUE(
        (*writer)->Write(frame, std::chrono::milliseconds(times_ms[i])).ok());
  }
  EXPECT_FALSE(fs::exists(path("o.mp4")));
  const absl::Status finished = (*writer)->Finish();
  ASSERT_TRUE(finished.ok()) << finished;
  EXPECT_EQ(NumFiles(), 1);

  const auto source = media::OpenVideoSource(path("o.mp4").string(), {});
  ASSERT_TRUE(source.ok()) << source.status();
  for (int i = 0; i < 8; ++i) {
    const auto frame = (*source)->Next();
    ASSERT_TRUE(frame.ok() && frame->has_value());
    // The container's clock ticks in 1/90000 s.
    EXPECT_NEAR(
        (*frame)->capture_time.count() * 1e-6, times_ms[i] - 1000, 0.02);
    const cv::Mat& bgr = (*frame)->bgr;
    EXPECT_EQ(bgr.size(), cv::Size(320, 240));
    // Only coarsely: OpenCV reads with the BT.601 matrix whatever the file
    // says.
    const cv::Scalar mean = cv::mean(bgr);
    for (int channel = 0; channel < 3; ++channel) {
      if (channel == i % 3) {
        EXPECT_GT(mean[channel], 170.0) << i;
      } else {
        EXPECT_LT(mean[channel], 70.0) << i;
      }
    }
  }
  const auto end = (*source)->Next();
  EXPECT_TRUE(end.ok() && !end->has_value());
}

TEST_F(OverlayWriterTest, LeavesNothingBehindIfNotFinished) {
  {
    auto writer = OverlayWriter::Create(path("o.mp4"), cv::Size(64, 48), 25.0);
    ASSERT_TRUE(writer.ok()) << writer.status();
    EXPECT_TRUE((*writer)
                    ->Write(cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(9)),
                            std::chrono::nanoseconds(0))
                    .ok());
    EXPECT_EQ(NumFiles(), 1);
  }
  EXPECT_EQ(NumFiles(), 0);
}

TEST_F(OverlayWriterTest, RefusesWhatItCannotWrite) {
  EXPECT_EQ(OverlayWriter::Create(path("o.txt"), cv::Size(64, 48), 25.0)
                .status()
                .code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(OverlayWriter::Create(path("o.mp4"), cv::Size(1, 48), 25.0)
                .status()
                .code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_FALSE(
      OverlayWriter::Create(path("none/o.mp4"), cv::Size(64, 48), 25.0).ok());
  auto writer = OverlayWriter::Create(path("o.mp4"), cv::Size(64, 48), 25.0);
  ASSERT_TRUE(writer.ok());
  EXPECT_FALSE((*writer)
                   ->Write(cv::Mat(50, 64, CV_8UC3, cv::Scalar::all(0)),
                           std::chrono::nanoseconds(0))
                   .ok());
}

}  // namespace
}  // namespace groundlock::cli
