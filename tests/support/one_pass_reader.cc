// SPDX-License-Identifier: Apache-2.0
#include "tests/support/one_pass_reader.h"

#include <opencv2/imgcodecs.hpp>

#include "absl/strings/str_cat.h"

namespace groundlock::test_support {

absl::StatusOr<OnePassReader> OnePassReader::Open(
    const cli::OnePassSequence& sequence) {
  OnePassReader reader;
  reader.sequence_ = &sequence;
  reader.frames_ = sequence.images.size();
  reader.frames_per_second_ = sequence.frames_per_second;
  if (sequence.video.empty()) return reader;
  if (!reader.video_.open(sequence.video.string())) {
    return absl::NotFoundError(
        absl::StrCat(sequence.video.string(), ": cannot read it"));
  }
  reader.frames_ = sequence.truth_px.size();
  const double frames_per_second = reader.video_.get(cv::CAP_PROP_FPS);
  if (frames_per_second > 0.0) reader.frames_per_second_ = frames_per_second;
  // One by one: seeking ends at key frames.
  for (int i = 0; i < sequence.first_frame; ++i) reader.video_.grab();
  return reader;
}

absl::StatusOr<cv::Mat> OnePassReader::Next() {
  cv::Mat image;
  if (sequence_->video.empty()) {
    image = cv::imread(sequence_->images.at(next_).string(), cv::IMREAD_COLOR);
  } else {
    video_.read(image);
  }
  if (image.empty()) {
    return absl::DataLossError(
        absl::StrCat(sequence_->name, ": frame ", next_, " cannot be read"));
  }
  ++next_;
  return image;
}

}  // namespace groundlock::test_support
