// SPDX-License-Identifier: Apache-2.0
// One-pass evaluation of single-object tracking as the online tracking
// benchmark does it (OTB: Y. Wu, J. Lim, M.-H. Yang, CVPR 2013).
#ifndef GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_
#define GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_

#include <array>
#include <filesystem>
#include <opencv2/videoio.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"

namespace groundlock::test_support {

struct OnePassSequence {
  std::string name;
  std::vector<std::filesystem::path> images;  // in the order of their names
  std::filesystem::path video;                // in place of images
  int first_frame = 0;                        // of the video
  double frames_per_second = 25.0;            // of images, which do not say
  // Of the first frames or all; not finite where the target cannot be seen.
  std::vector<geometry::Box2> truth_px;
};

// Sequences of images: FOLDER/<name>/groundtruth.txt (x,y,w,h per frame, pixels
// counted from 1) and FOLDER/<name>/img/*; img may be a text file with the
// images' folder, which is how a symbolic link is checked out where there are
// none. Flights: FOLDER/<name>.txt beside <name>.mp4, or, of one <name>.mp4,
// <name>_1.txt, <name>_2.txt and so on, each from the frame on with which the
// one before ends. Sorted by name. Errors name the file and the line.
absl::StatusOr<std::vector<OnePassSequence>> ReadOnePassSequences(
    const std::filesystem::path& folder);

// A sequence's frames one after the other. Not thread-safe.
class OnePassReader {
 public:
  // `sequence` outlives it. kNotFound: its video cannot be read.
  static absl::StatusOr<OnePassReader> Open(const OnePassSequence& sequence);
  // CV_8UC3; kDataLoss if a frame cannot be read.
  absl::StatusOr<cv::Mat> Next();
  // Of images all that there are; of a video those that have a truth.
  std::size_t frames() const { return frames_; }
  double frames_per_second() const { return frames_per_second_; }

 private:
  const OnePassSequence* sequence_ = nullptr;
  cv::VideoCapture video_;
  std::size_t frames_ = 0;
  std::size_t next_ = 0;
  double frames_per_second_ = 25.0;
};

inline constexpr int kOverlapSteps = 20;   // thresholds 0, 0.05, ... 1
inline constexpr int kDistanceSteps = 50;  // thresholds 0, 1, ... 50 px

// Shares of frames, of one sequence or the mean over several.
struct OnePassScore {
  std::array<double, kOverlapSteps + 1> success{};     // overlap above it
  std::array<double, kDistanceSteps + 1> precision{};  // centre within it
  double Auc() const;  // mean success over the thresholds
  double PrecisionAt20px() const { return precision[20]; }
};

// Compares frame by frame, as far as both go, where the truth is finite.
OnePassScore Rate(const std::vector<geometry::Box2>& found_px,
                  const std::vector<geometry::Box2>& truth_px);
OnePassScore Mean(const std::vector<OnePassScore>& scores);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_
