// SPDX-License-Identifier: Apache-2.0
// A discriminative correlation filter on gradients and colour names.
#ifndef GROUNDLOCK_SERVER_TARGET_DCF_TRACKER_H_
#define GROUNDLOCK_SERVER_TARGET_DCF_TRACKER_H_

#include "server/target/internal/dcf_features.h"
#include "server/target/internal/dcf_filter.h"
#include "server/target/internal/patch_sampler.h"
#include "server/target/internal/scale_filter.h"
#include "server/target/target_tracker.h"

namespace groundlock::target {

struct DcfTrackerOptions {
  internal::DcfFilterOptions filter;
  // Side of the square that is searched, in square roots of the target's area.
  double search_sides = 5.0;
};

// dcf_features.h and dcf_filter.h say how it sees and learns, scale_filter.h
// how it estimates scale where the caller does not fix the size.
class DcfTracker final : public TargetTracker {
 public:
  explicit DcfTracker(const DcfTrackerOptions& options = {});

  absl::Status Initialize(const cv::Mat& image,
                          const geometry::Box2& box_px) override;
  void Place(const geometry::Box2& box_px) override;
  absl::StatusOr<TargetObservation> Detect(const cv::Mat& image,
                                           bool fixed_size) override;
  void Learn(const cv::Mat& image) override;

 private:
  double SearchSide() const;  // px
  Eigen::Vector2d TargetCells() const;
  void ReadPatch(const cv::Mat& image);
  void Rescale(const cv::Mat& image);

  DcfTrackerOptions options_;
  internal::PatchSampler sampler_;
  internal::DcfFeatures features_;
  internal::DcfFilter filter_;
  internal::ScaleFilter scale_filter_;
  geometry::Box2 box_px_;
  bool initialized_ = false;
  bool scale_wanted_ = true;
  // Average peak-to-correlation energy of the last response.
  double sharpness_ = 0.0;
  double recent_sharpness_ = 0.0;  // exponential mean
};

}  // namespace groundlock::target

#endif  // GROUNDLOCK_SERVER_TARGET_DCF_TRACKER_H_
