// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/keyframes.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/order_statistics.h"

namespace groundlock::build {
namespace {

constexpr int kSharpnessWidth_px = 640;
constexpr int kFlowWidth_px = 320;
constexpr int kMaxPoints = 200;
constexpr std::size_t kMinPoints = 20;
constexpr std::size_t kMaxWindow = 32;
constexpr std::size_t kRecent = 31;
// Candidates come from the second half of the way to the next keyframe.
constexpr double kWindowFrom = 0.5;

cv::Mat Resized(const cv::Mat& luma, int width_px) {
  if (luma.cols <= width_px) return luma.clone();
  cv::Mat small;
  const int height = std::max(
      1, static_cast<int>(std::lround(1.0 * luma.rows * width_px / luma.cols)));
  cv::resize(luma, small, cv::Size(width_px, height), 0, 0, cv::INTER_AREA);
  return small;
}

}  // namespace

absl::Status KeyframeOptions::Validate() const {
  const auto check = [](const char* field, double value, double max) {
    if (value > 0.0 && value <= max) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat(field, ": ", value, " is not in (0, ", max, "]"));
  };
  if (auto status = check("spacing", spacing, 1.0); !status.ok()) return status;
  if (auto status = check("min_survivors", min_survivors, 1.0); !status.ok()) {
    return status;
  }
  return check("blurred_below", blurred_below, 1.0);
}

double Sharpness(const cv::Mat& luma) {
  const cv::Mat small = Resized(luma, kSharpnessWidth_px);
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(small, mean, deviation);
  const double brightness_variance = deviation[0] * deviation[0];
  if (brightness_variance < 1.0) return 0.0;
  cv::Mat laplacian;
  cv::Laplacian(small, laplacian, CV_16S, 3);
  cv::meanStdDev(laplacian, mean, deviation);
  return deviation[0] * deviation[0] / brightness_variance;
}

void KeyframeSelector::Add(const cv::Mat& luma) {
  Candidate candidate{
      num_frames_++, Resized(luma, kFlowWidth_px), Sharpness(luma)};
  recent_sharpness_.push_back(candidate.sharpness);
  if (recent_sharpness_.size() > kRecent) recent_sharpness_.pop_front();
  Process(candidate);
}

void KeyframeSelector::Anchor(const Candidate& candidate) {
  const double usual =
      base::Median({recent_sharpness_.begin(), recent_sharpness_.end()});
  keyframes_.push_back({candidate.frame,
                        candidate.sharpness,
                        candidate.sharpness < options_.blurred_below * usual});
  previous_ = candidate.small;
  start_points_.clear();
  cv::goodFeaturesToTrack(previous_, start_points_, kMaxPoints, 0.01, 6.0);
  points_ = start_points_;
  num_started_ = start_points_.size();
}

void KeyframeSelector::Process(const Candidate& candidate) {
  if (keyframes_.empty()) {
    // The walk begins where the first frame is that is not black.
    if (candidate.sharpness > 0.0) Anchor(candidate);
    return;
  }
  if (points_.size() >= kMinPoints) {
    std::vector<cv::Point2f> next;
    std::vector<unsigned char> found;
    std::vector<float> error;
    cv::calcOpticalFlowPyrLK(previous_,
                             candidate.small,
                             points_,
                             next,
                             found,
                             error,
                             cv::Size(15, 15),
                             3);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < next.size(); ++i) {
      if (found[i] == 0) continue;
      start_points_[kept] = start_points_[i];
      points_[kept++] = next[i];
    }
    start_points_.resize(kept);
    points_.resize(kept);
  } else {
    points_.clear();
    start_points_.clear();
  }
  previous_ = candidate.small;

  std::vector<double> moved;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const cv::Point2f step = points_[i] - start_points_[i];
    moved.push_back(std::hypot(step.x, step.y));
  }
  const double way =
      base::Median(moved) / (options_.spacing * candidate.small.cols);
  const double survivors = num_started_ == 0
                               ? 0.0
                               : static_cast<double>(points_.size()) /
                                     static_cast<double>(num_started_);
  const bool is_lost = points_.size() < kMinPoints;
  const double lost_half = 0.5 * (1.0 + options_.min_survivors);
  if (is_lost || way >= kWindowFrom || survivors < lost_half) {
    window_.push_back(candidate);
    if (window_.size() > kMaxWindow) window_.pop_front();
  }
  if (is_lost || way >= 1.0 || survivors < options_.min_survivors) Choose();
}

void KeyframeSelector::Choose() {
  // Of equals the latest: the others follow from there.
  std::size_t best = 0;
  for (std::size_t i = 0; i < window_.size(); ++i) {
    if (window_[i].sharpness >= window_[best].sharpness) best = i;
  }
  std::deque<Candidate> window = std::exchange(window_, {});
  Anchor(window[best]);
  // Those behind it start the next way.
  for (std::size_t i = best + 1; i < window.size(); ++i) Process(window[i]);
}

std::vector<Keyframe> KeyframeSelector::Finish() {
  if (!window_.empty()) Choose();
  return std::exchange(keyframes_, {});
}

std::vector<Keyframe> ThinOut(std::vector<Keyframe> keyframes,
                              std::size_t max_keyframes) {
  if (max_keyframes == 0 || keyframes.size() <= max_keyframes) return keyframes;
  std::vector<Keyframe> thinned;
  for (std::size_t i = 0; i < max_keyframes; ++i) {
    const std::size_t index =
        max_keyframes == 1
            ? 0
            : (i * (keyframes.size() - 1) + (max_keyframes - 1) / 2) /
                  (max_keyframes - 1);
    thinned.push_back(keyframes[index]);
  }
  return thinned;
}

}  // namespace groundlock::build
