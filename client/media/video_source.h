// SPDX-License-Identifier: Apache-2.0
// Where frames come from: a video file, a folder of images, a network stream or
// a camera.
#ifndef GROUNDLOCK_CLIENT_MEDIA_VIDEO_SOURCE_H_
#define GROUNDLOCK_CLIENT_MEDIA_VIDEO_SOURCE_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::media {

// Frames [begin, end), 0-based.
struct FrameRange {
  std::uint64_t begin = 0;
  std::uint64_t end = std::numeric_limits<std::uint64_t>::max();
};

struct SourceFrame {
  std::uint64_t number = 0;  // 0-based, in the input
  // Strictly increasing. Of a file: from its container, 0 at the first frame;
  // of a folder: number / fps; of a live input: this machine's monotone clock.
  std::chrono::nanoseconds capture_time{0};
  // The picture, CV_8UC3 in BGR order. Empty for a JPEG or PNG file of a
  // folder, which is sent as it is: see DecodeFrame.
  cv::Mat bgr;
  std::string encoded;  // a folder's JPEG or PNG file, its bytes
  std::string name;     // a folder's file name; else empty
};

// Not thread-safe.
class VideoSource {
 public:
  virtual ~VideoSource() = default;
  // The next frame; nullopt at the end. Errors name the input and the frame.
  virtual absl::StatusOr<std::optional<SourceFrame>> Next() = 0;
  // How many frames Next will return, as far as the input tells beforehand.
  virtual std::optional<std::uint64_t> num_frames() const = 0;
  virtual double fps() const = 0;
  // Frames come when they come, as from a camera: they cannot wait.
  virtual bool live() const = 0;
};

struct VideoSourceOptions {
  FrameRange frames;
  // Of a folder of images, and of inputs that do not tell; frames per second.
  double fps = 25.0;
};

// `input` is a video file, a folder with images (sorted by name), an rtsp://,
// http:// or similar URL, or a V4L2 device such as /dev/video0.
// kNotFound, kInvalidArgument (not readable as a video), kUnavailable (URL).
absl::StatusOr<std::unique_ptr<VideoSource>> OpenVideoSource(
    const std::string& input, const VideoSourceOptions& options);

// The input as messages show it: a URL without user and password, and without
// its query, which may hold one, too. OpenVideoSource's own messages are so.
std::string ShownInput(const std::string& input);

// .jpg, .jpeg, .png, .bmp, .tif, .tiff, .webp, .ppm, .pgm; also in capitals.
bool HasImageExtension(const std::filesystem::path& path);
// The images of a folder, sorted by name.
absl::StatusOr<std::vector<std::filesystem::path>> ListImages(
    const std::filesystem::path& folder);

// Reads one image: JPEG and PNG stay as their bytes, others are decoded.
absl::StatusOr<SourceFrame> ReadImage(const std::filesystem::path& path);

// The frame's picture, decoded if need be. Without the rotation that EXIF may
// ask for: the camera's intrinsics belong to the pixels as they are stored.
absl::StatusOr<cv::Mat> DecodeFrame(const SourceFrame& frame);

// Silences what FFmpeg and OpenCV print by themselves, apart from errors of
// FFmpeg; for main(), as it holds for the whole process.
void QuietMediaLibraries();

}  // namespace groundlock::media

#endif  // GROUNDLOCK_CLIENT_MEDIA_VIDEO_SOURCE_H_
