// SPDX-License-Identifier: Apache-2.0
// A video file of a stranger, decoded in a cage (decoder.h).
#ifndef GROUNDLOCK_MAP_STORE_DECODING_VIDEO_READER_H_
#define GROUNDLOCK_MAP_STORE_DECODING_VIDEO_READER_H_

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>

#include "absl/status/statusor.h"
#include "map_store/decoding/decoder.h"

namespace groundlock::decoding {

namespace internal {
class DecoderProcess;
}  // namespace internal

// Frame by frame, from the first; rotated phone videos are turned upright.
// Frames have the sizes that the file gives them, which may change. Only this
// one file is read, whatever others it names. Not thread-safe.
class VideoReader {
 public:
  // kNotFound; kInvalidArgument: not a video, or its decoder crashed or hung;
  // kResourceExhausted: the decoder's memory. Messages name the file.
  static absl::StatusOr<VideoReader> Open(const std::filesystem::path& video,
                                          const DecoderOptions& options = {});
  VideoReader(VideoReader&&) noexcept;
  VideoReader& operator=(VideoReader&&) noexcept;
  ~VideoReader();

  // As the file says it: not to be relied on. At least 1.
  double expected_frames() const { return expected_frames_; }
  // As the camera wrote it into the file: the focal length that has the same
  // diagonal angle of view on film of 36 mm x 24 mm, mm. Above 0.
  std::optional<double> film_focal_mm() const { return film_focal_mm_; }

  // The next frame's luma, CV_8UC1; empty behind the last one, or where the
  // file is cut or damaged. Errors as Open's.
  absl::StatusOr<cv::Mat> NextLuma();
  // The same frame, CV_8UC3, BGR.
  absl::StatusOr<cv::Mat> Colour();

 private:
  VideoReader(std::filesystem::path video,
              std::unique_ptr<internal::DecoderProcess> decoder);
  std::filesystem::path video_;
  std::unique_ptr<internal::DecoderProcess> decoder_;
  double expected_frames_ = 1.0;
  std::optional<double> film_focal_mm_;
};

}  // namespace groundlock::decoding

#endif  // GROUNDLOCK_MAP_STORE_DECODING_VIDEO_READER_H_
