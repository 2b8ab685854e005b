// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/video_reader.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/decoding/internal/decoder_process.h"

namespace groundlock::decoding {

using internal::Command;
using internal::DecoderProcess;

VideoReader::VideoReader(std::filesystem::path video,
                         std::unique_ptr<DecoderProcess> decoder)
    : video_(std::move(video)), decoder_(std::move(decoder)) {}
VideoReader::VideoReader(VideoReader&&) noexcept = default;
VideoReader& VideoReader::operator=(VideoReader&&) noexcept = default;
VideoReader::~VideoReader() = default;

absl::StatusOr<VideoReader> VideoReader::Open(
    const std::filesystem::path& video, const DecoderOptions& options) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(video, error)) {
    return absl::NotFoundError(absl::StrCat(video.string(), ": no such file"));
  }
  const int file = open(video.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) {
    return base::Annotate(absl::ErrnoToStatus(errno, "cannot be opened"),
                          video.string());
  }
  auto decoder = DecoderProcess::Start(options, file);
  close(file);
  RETURN_IF_ERROR(decoder.status());
  VideoReader reader(video, *std::move(decoder));
  const auto opened = reader.decoder_->Ask(Command::kOpenVideo);
  RETURN_IF_ERROR(base::Annotate(opened.status(), video.string()));
  reader.expected_frames_ = std::max(1.0, opened->number);
  const auto film_focal = reader.decoder_->Ask(Command::kFilmFocal);
  RETURN_IF_ERROR(base::Annotate(film_focal.status(), video.string()));
  if (film_focal->number > 0.0) reader.film_focal_mm_ = film_focal->number;
  return reader;
}

absl::StatusOr<cv::Mat> VideoReader::NextLuma() {
  auto decoded = decoder_->Ask(Command::kNextLuma);
  RETURN_IF_ERROR(base::Annotate(decoded.status(), video_.string()));
  if (!decoded->pixels.empty() && decoded->pixels.type() != CV_8UC1) {
    return absl::InvalidArgumentError(
        absl::StrCat(video_.string(), ": its decoder sent no luma"));
  }
  return std::move(decoded->pixels);
}

absl::StatusOr<cv::Mat> VideoReader::Colour() {
  auto decoded = decoder_->Ask(Command::kColour);
  RETURN_IF_ERROR(base::Annotate(decoded.status(), video_.string()));
  if (decoded->pixels.type() != CV_8UC3) {
    return absl::InvalidArgumentError(
        absl::StrCat(video_.string(), ": its decoder sent no colours"));
  }
  return std::move(decoded->pixels);
}

}  // namespace groundlock::decoding
