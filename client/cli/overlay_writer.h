// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_CLI_OVERLAY_WRITER_H_
#define GROUNDLOCK_CLIENT_CLI_OVERLAY_WRITER_H_

#include <chrono>
#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::cli {

// Writes pictures as H.264 video that browsers play (yuv420p, index in front).
// Written to a hidden file beside `path` and renamed by Finish: what stands at
// `path` is whole. Straight to FFmpeg's libraries rather than cv::VideoWriter,
// which knows neither a frame's own time nor a full disk. Not thread-safe.
class OverlayWriter {
 public:
  // path's extension names the container: .mp4, .mov, .mkv.
  // kInvalidArgument (extension, size), kUnavailable (no H.264 encoder),
  // kPermissionDenied or so (folder).
  static absl::StatusOr<std::unique_ptr<OverlayWriter>> Create(
      const std::filesystem::path& path, cv::Size size_px, double fps);
  ~OverlayWriter();  // without Finish: removes what was written

  // bgr: CV_8UC3 of the size given. A last odd row or column is left out, as
  // yuv420p has none. time: increasing; the first frame's becomes 0.
  absl::Status Write(const cv::Mat& bgr, std::chrono::nanoseconds time);
  absl::Status Finish();

 private:
  struct Impl;
  explicit OverlayWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_OVERLAY_WRITER_H_
