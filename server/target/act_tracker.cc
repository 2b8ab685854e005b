// SPDX-License-Identifier: Apache-2.0
#include "server/target/act_tracker.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "map_store/base/status.h"
#include "server/target/internal/input_check.h"
#include "server/target/internal/spectrum.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

// See the header for where these come from.
constexpr double kHalfConfidentPeak = 0.18;
constexpr double kRecentPeakRate = 0.2;
constexpr double kLearnAboveRecentPeak = 0.8;

double ConfidenceOfPeak(double peak) {
  const double fourth = std::pow(std::max(0.0, peak) / kHalfConfidentPeak, 4);
  return fourth / (1.0 + fourth);
}

}  // namespace

ActTracker::ActTracker(const internal::ActOptions& options)
    : options_(options), sampler_(options.model_cells), filter_(options) {}

Box2 ActTracker::PatchBox() const {
  return Box2::FromCenter(box_px_.center_px(),
                          box_px_.size_px() / options_.target_share);
}

absl::Status ActTracker::Initialize(const cv::Mat& image, const Box2& box_px) {
  RETURN_IF_ERROR(internal::CheckImage(image));
  RETURN_IF_ERROR(internal::CheckStartBox(image, box_px));
  box_px_ = box_px;
  sampler_.Sample(image, PatchBox());
  filter_.Train(sampler_);
  initialized_ = true;
  peak_ = 0.0;
  recent_peak_ = 1.0;
  return absl::OkStatus();
}

Box2 ActTracker::DetectBox(const Box2& box_px) const {
  // The first look ends half a patch aside at most; the second looks there.
  return internal::ReachOf(
      Box2::FromCenter(box_px.center_px(),
                       2.0 * box_px.size_px() / options_.target_share),
      sampler_.cells());
}

Box2 ActTracker::LearnBox(const Box2& box_px) const {
  return internal::ReachOf(
      Box2::FromCenter(box_px.center_px(),
                       box_px.size_px() / options_.target_share),
      sampler_.cells());
}

int ActTracker::Halvings(const Box2& box_px) const {
  return sampler_.Halvings(box_px.size_px() / options_.target_share);
}

void ActTracker::Place(const Box2& box_px) {
  if (internal::IsUsable(box_px)) box_px_ = box_px;
}

double ActTracker::Look(const cv::Mat& image) {
  sampler_.Sample(image, PatchBox());
  const internal::Peak peak = internal::FindPeak(filter_.Respond(sampler_));
  const Eigen::Vector2d cell_px =
      box_px_.size_px() / (options_.target_share * options_.model_cells);
  box_px_ = Box2::FromCenter(
      box_px_.center_px() + peak.shift_cells.cwiseProduct(cell_px),
      box_px_.size_px());
  return peak.value;
}

absl::StatusOr<TargetObservation> ActTracker::Detect(const cv::Mat& image,
                                                     bool /*fixed_size*/) {
  if (!initialized_) {
    return absl::FailedPreconditionError("act: Detect before Initialize");
  }
  RETURN_IF_ERROR(internal::CheckImage(image));
  peak_ = 0.0;
  if (internal::Touches(image, box_px_)) {
    const double first = Look(image);
    const Box2 found_px = box_px_;
    peak_ = Look(image);
    if (peak_ < first) {
      box_px_ = found_px;
      peak_ = first;
    }
  }
  recent_peak_ += kRecentPeakRate * (peak_ - recent_peak_);
  return TargetObservation{box_px_, ConfidenceOfPeak(peak_)};
}

void ActTracker::Learn(const cv::Mat& image) {
  if (!initialized_ || !internal::CheckImage(image).ok() ||
      !internal::Touches(image, box_px_)) {
    return;
  }
  if (peak_ < kHalfConfidentPeak ||
      peak_ < kLearnAboveRecentPeak * recent_peak_) {
    return;
  }
  sampler_.Sample(image, PatchBox());
  filter_.Update(sampler_);
}

}  // namespace groundlock::target
