// SPDX-License-Identifier: Apache-2.0
// OpenCV's trackers behind our interface, for comparison.
#ifndef GROUNDLOCK_SERVER_TARGET_OPEN_CV_TRACKER_H_
#define GROUNDLOCK_SERVER_TARGET_OPEN_CV_TRACKER_H_

#include <cstdint>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>
#include <string>
#include <vector>

#include "server/target/internal/patch_sampler.h"
#include "server/target/target_tracker.h"

namespace groundlock::target {

// What differs between OpenCV's trackers: creates a fresh one that is
// initialised on a frame and box; the result updates it, false if not found.
// Both may throw cv::Exception.
using OpenCvUpdate = std::function<bool(const cv::Mat&, cv::Rect2d&)>;
using OpenCvStart =
    std::function<OpenCvUpdate(const cv::Mat&, const cv::Rect2d&)>;

// None of OpenCV's trackers can be moved, resized or kept from learning, and
// some of them crash when the image's size changes. So each sees a canvas of
// constant size, which is the image itself until Place says that the target is
// elsewhere; then it is the image moved and scaled such that the target lies
// where the tracker believes it to be. Learn does nothing: they learn in
// Detect.
//
// Confidence, 0 where OpenCV says it lost the target, is the normalised
// correlation of the box's content (gray, 24 x 24) with the better of the first
// appearance and a running mean of the believed ones, so that it means the same
// for all of them; negative correlation counts as 0.
class OpenCvTracker final : public TargetTracker {
 public:
  // `name` for messages.
  OpenCvTracker(std::string name, OpenCvStart start);

  absl::Status Initialize(const cv::Mat& image,
                          const geometry::Box2& box_px) override;
  void Place(const geometry::Box2& box_px) override;
  absl::StatusOr<TargetObservation> Detect(const cv::Mat& image,
                                           bool fixed_size) override;
  void Learn(const cv::Mat& /*image*/) override {}

 private:
  // p_canvas = scale * p_image + offset.
  struct View {
    double scale = 1.0;
    Eigen::Vector2d offset_px = Eigen::Vector2d::Zero();
    bool IsIdentity() const { return scale == 1.0 && offset_px.isZero(0.0); }
  };

  const cv::Mat& ToCanvas(const cv::Mat& image);
  bool Update(const cv::Mat& canvas);
  geometry::Box2 BoxFromRect() const;
  std::vector<float> Appearance(const cv::Mat& image);
  double Correlate(const cv::Mat& image);

  std::string name_;
  OpenCvStart start_;
  OpenCvUpdate update_;
  std::uint64_t frame_ = 0;
  cv::Size canvas_size_;
  cv::Mat colour_, canvas_;
  View view_;
  // What the tracker follows, in the canvas: the part of the target's box that
  // it can work with, and where the box lies relative to it.
  cv::Rect2d rect_;
  Eigen::Vector2d box_center_in_rect_ = Eigen::Vector2d::Zero();  // rect sizes
  Eigen::Vector2d box_size_in_rect_ = Eigen::Vector2d::Ones();
  geometry::Box2 box_px_;
  internal::PatchSampler sampler_;
  std::vector<float> first_appearance_, mean_appearance_;
};

// Names of OpenCV's trackers and how each starts.
struct OpenCvTrackerKind {
  std::string name;
  OpenCvStart start;
};
const std::vector<OpenCvTrackerKind>& OpenCvTrackerKinds();

}  // namespace groundlock::target

#endif  // GROUNDLOCK_SERVER_TARGET_OPEN_CV_TRACKER_H_
