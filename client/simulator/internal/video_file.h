// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_VIDEO_FILE_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_VIDEO_FILE_H_

#include <cstdint>
#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::simulator {

// An MP4 file with one H.264 stream, nearly lossless (crf 16), yuv420p bt709.
// OpenCV's VideoWriter sets neither the quality nor the colour space.
class VideoFile {
 public:
  // Even width and height. Errors name the file and FFmpeg's reason.
  static absl::StatusOr<std::unique_ptr<VideoFile>> Create(
      const std::filesystem::path& path, cv::Size size_px, double fps);
  VideoFile(const VideoFile&) = delete;
  VideoFile& operator=(const VideoFile&) = delete;
  // A file that was not finished is not playable.
  ~VideoFile();

  absl::Status Write(const cv::Mat& bgr);  // CV_8UC3 of the size given
  absl::Status Finish();

 private:
  struct State;
  explicit VideoFile(std::unique_ptr<State> state);
  absl::Status Drain();

  std::unique_ptr<State> state_;
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_VIDEO_FILE_H_
