// SPDX-License-Identifier: Apache-2.0
// Which frames of a video are worth mapping: sharp ones, a step apart.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_KEYFRAMES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_KEYFRAMES_H_

#include <cstdint>
#include <deque>
#include <opencv2/core.hpp>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::build {

struct KeyframeOptions {
  // A new keyframe is due when half of the points that are followed have moved
  // by this share of the image's width since the last one ...
  double spacing = 0.04;
  // ... or fewer than this share of them can be followed any more.
  double min_survivors = 0.6;
  // Frames whose sharpness is below this share of the median of their
  // neighbours count as blurred.
  double blurred_below = 0.5;
  absl::Status Validate() const;  // names field, value and bound
};

struct Keyframe {
  std::uint64_t frame = 0;  // 0-based
  double sharpness = 0.0;   // see Sharpness
  // The sharpest that there was, yet far below its neighbours.
  bool is_blurred = false;
};

// Variance of the Laplacian of a CV_8UC1 image over its brightness' variance,
// at a fixed width of 640 px: falls as blur grows, and hardly depends on what
// is seen. 0 for an image without content.
// Source: Pech-Pacheco et al. 2000 (variance of the Laplacian).
double Sharpness(const cv::Mat& luma);

// Takes frames one by one. Between two places where a keyframe is due, the
// sharpest frame of the last half of the way is chosen. Deterministic. Not
// thread-safe.
class KeyframeSelector {
 public:
  explicit KeyframeSelector(const KeyframeOptions& options)
      : options_(options) {}

  // luma: CV_8UC1; all frames of one size.
  void Add(const cv::Mat& luma);
  // The keyframes, in order; the last frame ends the way.
  std::vector<Keyframe> Finish();

 private:
  struct Candidate {
    std::uint64_t frame = 0;
    cv::Mat small;
    double sharpness = 0.0;
  };
  void Process(const Candidate& candidate);
  void Anchor(const Candidate& candidate);
  void Choose();

  const KeyframeOptions options_;
  std::uint64_t num_frames_ = 0;
  std::vector<Keyframe> keyframes_;
  std::deque<double> recent_sharpness_;
  // Followed from the last keyframe to the previous frame.
  cv::Mat previous_;
  std::vector<cv::Point2f> start_points_;
  std::vector<cv::Point2f> points_;
  std::size_t num_started_ = 0;
  // From half way to the next keyframe on, at most kMaxWindow.
  std::deque<Candidate> window_;
};

// At most max_keyframes of them, spread evenly; 0 = all.
std::vector<Keyframe> ThinOut(std::vector<Keyframe> keyframes,
                              std::size_t max_keyframes);

}  // namespace groundlock::build

#endif  // GROUNDLOCK_MAP_STORE_BUILD_KEYFRAMES_H_
