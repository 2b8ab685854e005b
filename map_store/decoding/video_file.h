// SPDX-License-Identifier: Apache-2.0
// The frames of a video file by FFmpeg's libraries, in this process: for
// decoders in their cages (decoder.h), and for clients who show their own
// files.
#ifndef GROUNDLOCK_MAP_STORE_DECODING_VIDEO_FILE_H_
#define GROUNDLOCK_MAP_STORE_DECODING_VIDEO_FILE_H_

#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <string_view>

namespace groundlock::decoding {

// What to tell whoever gave a file that VideoFile::Open does not open.
inline constexpr char kUnreadableVideo[] =
    "cannot be read as a video: it is no video or holds no pictures, or its "
    "end is missing because a recording or a copy was interrupted";

// Not thread-safe.
class VideoFile {
 public:
  // nullptr: no video that can be read.
  static std::unique_ptr<VideoFile> Open(const std::string& path);
  VideoFile(const VideoFile&) = delete;
  VideoFile& operator=(const VideoFile&) = delete;
  ~VideoFile();

  // As the file says them: not to be relied on. 0 = it does not.
  double expected_frames() const;
  double fps() const;
  // The focal length that has the same diagonal angle of view on film of
  // 36 mm x 24 mm, mm, as cameras write it into their videos.
  std::optional<double> film_focal_mm() const;

  // Goes on to the next frame; false behind the last one, or where the file is
  // cut or damaged.
  bool Grab();
  // Of the frame, s since the first one; nullopt if the file does not tell.
  std::optional<double> time_s() const;
  // The frame, CV_8UC3, BGR, turned upright where the file asks for that.
  // Frames may differ in size. The pixels stay until the next call. Empty if
  // they cannot be had. Throws cv::Exception where memory is short.
  cv::Mat Bgr();

 private:
  struct Parts;
  explicit VideoFile(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

// What cameras write of their focal length: "24.00mm" (QuickTime's
// camera.focal_length.35mm_equivalent); in the subtitles of DJI's drones
// "[focal_len: 24.00]", or "[focal_len : 240]" in tenths. mm; nullopt if it is
// neither, or no focal length of a lens.
std::optional<double> FilmFocalFromText(std::string_view text);

}  // namespace groundlock::decoding

#endif  // GROUNDLOCK_MAP_STORE_DECODING_VIDEO_FILE_H_
