// SPDX-License-Identifier: Apache-2.0
#include "client/media/video_source.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "map_store/base/file.h"
#include "map_store/base/image_header.h"
#include "map_store/base/status.h"
#include "map_store/decoding/video_file.h"

extern "C" {
#include <libavutil/log.h>
}

namespace groundlock::media {
namespace {

namespace fs = std::filesystem;
using std::chrono::nanoseconds;

// Larger than any camera's photo; the server's own limit is lower.
constexpr std::uint64_t kMaxImageBytes = std::uint64_t{1} << 28;
// A network stream that says nothing for this long is gone, ms.
constexpr int kNetworkTimeoutMs = 10'000;

nanoseconds FromSeconds(double seconds) {
  return nanoseconds(std::llround(seconds * 1e9));
}

std::string LowerExtension(const fs::path& path) {
  return absl::AsciiStrToLower(path.extension().string());
}

bool IsUrl(const std::string& input) {
  return input.find("://") != std::string::npos;
}

// What frames are taken from, one after the other.
class Capture {
 public:
  virtual ~Capture() = default;
  virtual bool Grab() = 0;
  virtual bool Retrieve(cv::Mat& bgr) = 0;  // a copy
  virtual double fps() const = 0;           // 0 = it does not tell
  virtual double num_frames() const = 0;    // likewise
  virtual std::optional<double> time_s() const = 0;
};

// A network stream or a camera, through OpenCV.
class LiveCapture : public Capture {
 public:
  explicit LiveCapture(const cv::VideoCapture& capture)  // shared by its copies
      : capture_(capture) {}
  bool Grab() override { return capture_.grab(); }
  bool Retrieve(cv::Mat& bgr) override { return capture_.retrieve(bgr); }
  double fps() const override { return capture_.get(cv::CAP_PROP_FPS); }
  double num_frames() const override { return 0.0; }
  std::optional<double> time_s() const override { return std::nullopt; }

 private:
  cv::VideoCapture capture_;
};

// OpenCV would give all of a file's frames the size of its first one, whatever
// they are.
class FileCapture : public Capture {
 public:
  explicit FileCapture(std::unique_ptr<decoding::VideoFile> file)
      : file_(std::move(file)) {}
  bool Grab() override { return file_->Grab(); }
  bool Retrieve(cv::Mat& bgr) override {
    file_->Bgr().copyTo(bgr);
    return true;
  }
  double fps() const override { return file_->fps(); }
  double num_frames() const override { return file_->expected_frames(); }
  std::optional<double> time_s() const override { return file_->time_s(); }

 private:
  const std::unique_ptr<decoding::VideoFile> file_;
};

class CaptureSource : public VideoSource {
 public:
  // input: as messages show it.
  CaptureSource(std::string input,
                std::unique_ptr<Capture> capture,
                const VideoSourceOptions& options,
                bool live)
      : input_(std::move(input)),
        capture_(std::move(capture)),
        range_(options.frames),
        live_(live) {
    fps_ = capture_->fps();
    // Some containers tell nonsense such as 90000 (their time base).
    if (!(fps_ > 0.0 && fps_ <= 1000.0)) fps_ = options.fps;
    last_interval_ = FromSeconds(1.0 / fps_);
    const double count = live_ ? 0.0 : capture_->num_frames();
    if (count > 0.0 && count < 1e12) {
      const auto total = static_cast<std::uint64_t>(count);
      const std::uint64_t end = std::min(range_.end, total);
      num_frames_ = end > range_.begin ? end - range_.begin : 0;
    } else if (range_.end != FrameRange{}.end) {
      num_frames_ = range_.end - range_.begin;
    }
  }

  absl::StatusOr<std::optional<SourceFrame>> Next() override {
    try {
      return NextOrThrow();
    } catch (const cv::Exception& e) {
      return absl::DataLossError(
          absl::StrCat(input_, ": frame ", next_, ": ", e.what()));
    }
  }

  std::optional<std::uint64_t> num_frames() const override {
    return num_frames_;
  }
  double fps() const override { return fps_; }
  bool live() const override { return live_; }

 private:
  absl::StatusOr<std::optional<SourceFrame>> NextOrThrow() {
    while (next_ < range_.end) {
      if (!capture_->Grab()) return std::optional<SourceFrame>();
      const std::uint64_t number = next_++;
      const nanoseconds capture_time = CaptureTime(number);
      // Frames before the range are decoded too, rather than sought: seeking
      // to an exact frame is not reliable in every container.
      if (number < range_.begin) continue;
      SourceFrame frame;
      frame.number = number;
      frame.capture_time = capture_time;
      if (!capture_->Retrieve(frame.bgr) || frame.bgr.empty()) {
        return absl::DataLossError(
            absl::StrCat(input_, ": frame ", number, " cannot be decoded"));
      }
      if (frame.bgr.type() != CV_8UC3) {
        return absl::InvalidArgumentError(absl::StrCat(
            input_, ": frame ", number, " is not an 8-bit colour image"));
      }
      return std::optional<SourceFrame>(std::move(frame));
    }
    return std::optional<SourceFrame>();
  }

  // The server needs times that increase. Where the container's clock is broken
  // or absent, a frame lasts as long as the one before it.
  nanoseconds CaptureTime(std::uint64_t number) {
    nanoseconds time;
    if (live_) {
      // Not since the opening: a session may outlive this program.
      time = std::chrono::steady_clock::now().time_since_epoch();
    } else {
      time = FromSeconds(capture_->time_s().value_or(0.0));
    }
    if (number == 0) {
      time = std::max(time, nanoseconds(0));
    } else if (time <= last_time_) {
      time = last_time_ + (live_ ? nanoseconds(1) : last_interval_);
    } else {
      last_interval_ = time - last_time_;
    }
    last_time_ = time;
    return time;
  }

  const std::string input_;
  const std::unique_ptr<Capture> capture_;
  const FrameRange range_;
  const bool live_;
  double fps_ = 0.0;
  std::optional<std::uint64_t> num_frames_;
  std::uint64_t next_ = 0;
  nanoseconds last_time_{0};
  nanoseconds last_interval_{0};
};

class FolderSource : public VideoSource {
 public:
  FolderSource(std::vector<fs::path> images, const VideoSourceOptions& options)
      : images_(std::move(images)),
        fps_(options.fps),
        begin_(std::min<std::uint64_t>(options.frames.begin, images_.size())),
        end_(std::min<std::uint64_t>(options.frames.end, images_.size())),
        next_(begin_) {}

  absl::StatusOr<std::optional<SourceFrame>> Next() override {
    if (next_ >= end_) return std::optional<SourceFrame>();
    ASSIGN_OR_RETURN(SourceFrame frame, ReadImage(images_[next_]));
    frame.number = next_;
    frame.capture_time = FromSeconds(static_cast<double>(next_) / fps_);
    ++next_;
    return std::optional<SourceFrame>(std::move(frame));
  }

  std::optional<std::uint64_t> num_frames() const override {
    return end_ > begin_ ? end_ - begin_ : 0;
  }
  double fps() const override { return fps_; }
  bool live() const override { return false; }

 private:
  const std::vector<fs::path> images_;
  const double fps_;
  const std::uint64_t begin_;
  const std::uint64_t end_;
  std::uint64_t next_;
};

absl::StatusOr<std::unique_ptr<VideoSource>> OpenCapture(
    const std::string& input, const VideoSourceOptions& options, bool device) {
  const bool url = IsUrl(input);
  const std::string shown = ShownInput(input);
  if (!device && !url) {
    auto file = decoding::VideoFile::Open(input);
    if (file == nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat(shown, ": ", decoding::kUnreadableVideo));
    }
    return std::make_unique<CaptureSource>(
        shown,
        std::make_unique<FileCapture>(std::move(file)),
        options,
        /*live=*/false);
  }
  cv::VideoCapture capture;
  bool opened = false;
  std::string reason;
  try {
    if (device) {
      opened = capture.open(input, cv::CAP_V4L2);
    } else {
      opened = capture.open(input,
                            cv::CAP_FFMPEG,
                            {cv::CAP_PROP_OPEN_TIMEOUT_MSEC,
                             kNetworkTimeoutMs,
                             cv::CAP_PROP_READ_TIMEOUT_MSEC,
                             kNetworkTimeoutMs});
    }
  } catch (const cv::Exception& e) {
    reason = absl::StrCat(
        " (", absl::StrReplaceAll(e.what(), {{input, shown}}), ")");
  }
  if (!opened) {
    if (url) {
      return absl::UnavailableError(absl::StrCat(
          shown, ": no video stream could be opened there", reason));
    }
    return absl::InvalidArgumentError(
        absl::StrCat(shown, ": cannot be opened as a camera", reason));
  }
  return std::make_unique<CaptureSource>(
      shown, std::make_unique<LiveCapture>(capture), options, /*live=*/true);
}

}  // namespace

std::string ShownInput(const std::string& input) {
  if (!IsUrl(input)) return input;
  const std::size_t host = input.find("://") + 3;
  const std::size_t host_end =
      std::min(input.find_first_of("/?#", host), input.size());
  // The last one: a password may hold an @ of its own, or even a slash, in
  // which case too much is hidden rather than too little.
  std::size_t at = input.rfind('@');
  if (at != std::string::npos && at > host_end &&
      input.substr(host, host_end - host).find(':') == std::string::npos) {
    at = std::string::npos;  // of the path: no password stands before it
  }
  const std::size_t rest = at == std::string::npos ? host : at + 1;
  const std::size_t query = std::min(input.find('?', rest), input.size());
  return absl::StrCat(input.substr(0, host),
                      rest == host ? "" : "...@",
                      input.substr(rest, query - rest),
                      query == input.size() ? "" : "?...");
}

bool HasImageExtension(const fs::path& path) {
  constexpr std::array<std::string_view, 9> kExtensions = {".jpg",
                                                           ".jpeg",
                                                           ".png",
                                                           ".bmp",
                                                           ".tif",
                                                           ".tiff",
                                                           ".webp",
                                                           ".ppm",
                                                           ".pgm"};
  return std::find(kExtensions.begin(),
                   kExtensions.end(),
                   LowerExtension(path)) != kExtensions.end();
}

absl::StatusOr<std::vector<fs::path>> ListImages(const fs::path& folder) {
  std::vector<fs::path> images;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (HasImageExtension(it->path()) && it->is_regular_file()) {
      images.push_back(it->path());
    }
  }
  if (error) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": ", error.message()));
  }
  if (images.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(folder.string(), ": no images in this folder"));
  }
  std::sort(images.begin(), images.end());
  return images;
}

absl::StatusOr<SourceFrame> ReadImage(const fs::path& path) {
  ASSIGN_OR_RETURN(std::string bytes, base::ReadFile(path, kMaxImageBytes));
  SourceFrame frame;
  frame.name = path.filename().string();
  // By content, not by name: that is how the server tells them apart.
  if (absl::StartsWith(bytes, "\xFF\xD8\xFF") ||
      absl::StartsWith(bytes, "\x89PNG\r\n\x1A\n")) {
    frame.encoded = std::move(bytes);
    return frame;
  }
  frame.encoded = std::move(bytes);
  auto bgr = DecodeFrame(frame);
  if (!bgr.ok())
    return base::Annotate(bgr.status(), path.parent_path().string());
  frame.bgr = *std::move(bgr);
  frame.encoded.clear();
  return frame;
}

absl::StatusOr<cv::Mat> DecodeFrame(const SourceFrame& frame) {
  if (!frame.bgr.empty()) return frame.bgr;
  const auto unreadable = [&](std::string_view why) {
    return absl::InvalidArgumentError(absl::StrCat(
        frame.name.empty() ? absl::StrCat("frame ", frame.number) : frame.name,
        ": not a readable image",
        base::Abseil(why)));
  };
  if (frame.encoded.empty()) return unreadable(": the file is empty");
  if (const absl::Status size =
          base::CheckImageSize(frame.encoded, base::kMaxPhotoPixels);
      !size.ok()) {
    return unreadable(absl::StrCat(": ", size.message()));
  }
  try {
    const cv::Mat bytes(1,
                        static_cast<int>(frame.encoded.size()),
                        CV_8UC1,
                        const_cast<char*>(frame.encoded.data()));
    cv::Mat bgr =
        cv::imdecode(bytes, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
    if (bgr.empty()) return unreadable("");
    return bgr;
  } catch (const cv::Exception& e) {
    return unreadable(absl::StrCat(": ", e.what()));
  }
}

absl::StatusOr<std::unique_ptr<VideoSource>> OpenVideoSource(
    const std::string& input, const VideoSourceOptions& options) {
  if (!(options.fps > 0.0 && options.fps <= 1000.0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("fps ", options.fps, ": expected above 0, at most 1000"));
  }
  if (IsUrl(input)) return OpenCapture(input, options, /*device=*/false);
  std::error_code error;
  const fs::file_status status = fs::status(input, error);
  if (status.type() == fs::file_type::not_found) {
    return absl::NotFoundError(
        absl::StrCat(input, ": no such file, folder or device"));
  }
  if (error) {
    return absl::InvalidArgumentError(
        absl::StrCat(input, ": ", error.message()));
  }
  if (fs::is_directory(status)) {
    ASSIGN_OR_RETURN(std::vector<fs::path> images, ListImages(input));
    return std::make_unique<FolderSource>(std::move(images), options);
  }
  return OpenCapture(input, options, /*device=*/fs::is_character_file(status));
}

void QuietMediaLibraries() {
  av_log_set_level(AV_LOG_ERROR);
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
}

}  // namespace groundlock::media
