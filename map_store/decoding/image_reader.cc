// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/image_reader.h"

#include <utility>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/image_header.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"
#include "map_store/decoding/internal/decoder_process.h"

namespace groundlock::decoding {

using internal::Command;
using internal::DecoderProcess;

class ImageReader::Pool {
 public:
  explicit Pool(const DecoderOptions& options) : options_(options) {}

  absl::StatusOr<cv::Mat> Read(const std::filesystem::path& path,
                               Command command) {
    ASSIGN_OR_RETURN(const std::string bytes,
                     base::ReadFile(path, internal::kMaxEncodedBytes));
    auto pixels = Decode(bytes, command);
    if (pixels.ok()) return pixels;
    return base::Annotate(pixels.status(), path.string());
  }

 private:
  absl::StatusOr<cv::Mat> Decode(const std::string& bytes, Command command) {
    RETURN_IF_ERROR(base::CheckImageSize(bytes, base::kMaxPhotoPixels));
    ASSIGN_OR_RETURN(std::unique_ptr<DecoderProcess> decoder, Take());
    auto decoded = decoder->Ask(command, bytes);
    if (decoder->is_alive()) {
      base::MutexLock lock(&mutex_);
      idle_.push_back(std::move(decoder));
    }
    RETURN_IF_ERROR(decoded.status());
    const int type = command == Command::kDecodeColour ? CV_8UC3 : CV_8UC1;
    if (decoded->pixels.empty() || decoded->pixels.type() != type) {
      return absl::InvalidArgumentError("cannot be read as an image");
    }
    return std::move(decoded->pixels);
  }

  absl::StatusOr<std::unique_ptr<DecoderProcess>> Take() {
    {
      base::MutexLock lock(&mutex_);
      if (!idle_.empty()) {
        auto decoder = std::move(idle_.back());
        idle_.pop_back();
        return decoder;
      }
    }
    return DecoderProcess::Start(options_);
  }

  const DecoderOptions options_;
  base::Mutex mutex_;
  std::vector<std::unique_ptr<DecoderProcess>> idle_ ABSL_GUARDED_BY(mutex_);
};

ImageReader::ImageReader(const DecoderOptions& options)
    : pool_(std::make_unique<Pool>(options)) {}
ImageReader::~ImageReader() = default;

absl::StatusOr<cv::Mat> ImageReader::ReadColour(
    const std::filesystem::path& path) {
  return pool_->Read(path, Command::kDecodeColour);
}

absl::StatusOr<cv::Mat> ImageReader::ReadLuma(
    const std::filesystem::path& path) {
  return pool_->Read(path, Command::kDecodeLuma);
}

}  // namespace groundlock::decoding
