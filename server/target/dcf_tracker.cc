// SPDX-License-Identifier: Apache-2.0
#include "server/target/dcf_tracker.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "map_store/base/status.h"
#include "server/target/internal/input_check.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

// See the header for where these come from.
constexpr double kHalfConfidentSharpness = 12.0;
constexpr double kLearnAbove = 10.0;
constexpr double kLearnAboveRecent = 0.25;
constexpr double kRecentRate = 0.2;

double ConfidenceOfSharpness(double sharpness) {
  const double fourth =
      std::pow(std::max(0.0, sharpness) / kHalfConfidentSharpness, 4);
  return fourth / (1.0 + fourth);
}

// Average peak-to-correlation energy: M. Wang, Y. Liu, Z. Huang, "Large margin
// object tracking with circulant feature maps", CVPR 2017, equation 9.
double PeakToEnergy(const cv::Mat& response) {
  double low = 0.0;
  double high = 0.0;
  cv::minMaxLoc(response, &low, &high);
  double sum = 0.0;
  for (int y = 0; y < response.rows; ++y) {
    const auto* row = response.ptr<float>(y);
    for (int x = 0; x < response.cols; ++x) {
      sum += (row[x] - low) * (row[x] - low);
    }
  }
  const double mean = sum / static_cast<double>(response.total());
  return mean > 0.0 ? (high - low) * (high - low) / mean : 0.0;
}

}  // namespace

DcfTracker::DcfTracker(const DcfTrackerOptions& options)
    : options_(options),
      sampler_(options_.filter.cells * internal::GradientHistogram::kCellPx),
      features_(options_.filter.cells),
      filter_(options_.filter) {}

Eigen::Vector2d DcfTracker::SearchSize() const {
  return box_px_.size_px().cwiseProduct(search_sizes_);
}

Eigen::Vector2d DcfTracker::TargetCells() const {
  return options_.filter.cells * search_sizes_.cwiseInverse();
}

void DcfTracker::ReadPatch(const cv::Mat& image) {
  sampler_.Sample(image, Box2::FromCenter(box_px_.center_px(), SearchSize()));
  features_.Compute(sampler_, filter_.Patch());
}

absl::Status DcfTracker::Initialize(const cv::Mat& image, const Box2& box_px) {
  RETURN_IF_ERROR(internal::CheckImage(image));
  RETURN_IF_ERROR(internal::CheckStartBox(image, box_px));
  box_px_ = box_px;
  const double side_px =
      options_.search_sides * std::sqrt(box_px.size_px().prod());
  search_sizes_ = side_px * box_px.size_px().cwiseInverse();
  ReadPatch(image);
  filter_.Train(TargetCells());
  scale_filter_.Train(image, box_px_);
  initialized_ = true;
  sharpness_ = 0.0;
  recent_sharpness_ = 0.0;
  return absl::OkStatus();
}

void DcfTracker::Place(const Box2& box_px) {
  if (internal::IsUsable(box_px)) box_px_ = box_px;
}

void DcfTracker::Rescale(const cv::Mat& image) {
  const double factor = scale_filter_.Estimate(image, box_px_);
  const Box2 scaled_px =
      Box2::FromCenter(box_px_.center_px(), factor * box_px_.size_px());
  // A target neither vanishes between the pixels nor outgrows the image.
  if (scaled_px.size_px().minCoeff() < 2.0 && factor < 1.0) return;
  if (factor > 1.0 &&
      (scaled_px.width() > image.cols || scaled_px.height() > image.rows)) {
    return;
  }
  box_px_ = scaled_px;
}

absl::StatusOr<TargetObservation> DcfTracker::Detect(const cv::Mat& image,
                                                     bool fixed_size) {
  if (!initialized_) {
    return absl::FailedPreconditionError("dcf: Detect before Initialize");
  }
  RETURN_IF_ERROR(internal::CheckImage(image));
  sharpness_ = 0.0;
  scale_wanted_ = !fixed_size;
  if (internal::Touches(image, box_px_)) {
    ReadPatch(image);
    sharpness_ = PeakToEnergy(filter_.Respond());
    const internal::Peak peak = filter_.RefinedPeak();
    const Eigen::Vector2d cell_px = SearchSize() / options_.filter.cells;
    box_px_ = Box2::FromCenter(
        box_px_.center_px() + cell_px.cwiseProduct(peak.shift_cells),
        box_px_.size_px());
    if (!fixed_size && internal::Touches(image, box_px_)) Rescale(image);
  }
  recent_sharpness_ += kRecentRate * (sharpness_ - recent_sharpness_);
  return TargetObservation{box_px_, ConfidenceOfSharpness(sharpness_)};
}

void DcfTracker::Learn(const cv::Mat& image) {
  if (!initialized_ || !internal::CheckImage(image).ok() ||
      !internal::Touches(image, box_px_)) {
    return;
  }
  if (sharpness_ < kLearnAbove ||
      sharpness_ < kLearnAboveRecent * recent_sharpness_) {
    return;
  }
  ReadPatch(image);
  filter_.Update(TargetCells());
  if (scale_wanted_) scale_filter_.Update(image, box_px_);
}

}  // namespace groundlock::target
