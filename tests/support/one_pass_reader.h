// SPDX-License-Identifier: Apache-2.0
// The frames of a sequence with a box per frame.
#ifndef GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_READER_H_
#define GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_READER_H_

#include <opencv2/videoio.hpp>

#include "absl/status/statusor.h"
#include "client/cli/evaluate/one_pass.h"

namespace groundlock::test_support {

// A sequence's frames one after the other. Not thread-safe.
class OnePassReader {
 public:
  // `sequence` outlives it. kNotFound: its video cannot be read.
  static absl::StatusOr<OnePassReader> Open(
      const cli::OnePassSequence& sequence);
  // CV_8UC3; kDataLoss if a frame cannot be read.
  absl::StatusOr<cv::Mat> Next();
  // Of images all that there are; of a video those that have a truth.
  std::size_t frames() const { return frames_; }
  double frames_per_second() const { return frames_per_second_; }

 private:
  const cli::OnePassSequence* sequence_ = nullptr;
  cv::VideoCapture video_;
  std::size_t frames_ = 0;
  std::size_t next_ = 0;
  double frames_per_second_ = 25.0;
};

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_READER_H_
