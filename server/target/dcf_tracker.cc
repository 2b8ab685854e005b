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

constexpr double kColourRate = 0.04;  // as Staple

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

double PeakToSidelobe(const cv::Mat& response, const internal::Peak& peak) {
  constexpr int kHalf = 5;
  const int n = response.rows;
  const auto distance = [n](int at, double center) {
    const int d = std::abs(at - static_cast<int>(std::lround(center)));
    return std::min(d, std::abs(n - d));
  };
  double sum = 0.0;
  double squares = 0.0;
  int count = 0;
  for (int y = 0; y < n; ++y) {
    const auto* row = response.ptr<float>(y);
    const bool near = distance(y, peak.shift_cells.y()) <= kHalf;
    for (int x = 0; x < n; ++x) {
      if (near && distance(x, peak.shift_cells.x()) <= kHalf) continue;
      sum += row[x];
      squares += row[x] * row[x];
      ++count;
    }
  }
  const double mean = sum / count;
  const double variance = squares / count - mean * mean;
  return variance > 0.0 ? (peak.value - mean) / std::sqrt(variance) : 0.0;
}

}  // namespace

DcfTracker::DcfTracker(const DcfTrackerOptions& options)
    : options_(options),
      sampler_(options_.filter.cells * internal::GradientHistogram::kCellPx),
      features_(options_.filter.cells, options_.colour_names),
      filter_(options_.filter),
      colours_(sampler_.cells()),
      merged_(options_.filter.cells, options_.filter.cells, CV_32F) {}

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
  colours_.Learn(sampler_, SamplesOfCells(TargetCells()), 1.0);
  scale_filter_.Train(image, box_px_);
  initialized_ = true;
  signals_ = {};
  recent_sharpness_ = 0.0;
  return absl::OkStatus();
}

Box2 DcfTracker::ReadBox(const Box2& box_px) const {
  // A search ends half its size aside at most; the scale is looked for there.
  const Eigen::Vector2d search_px = box_px.size_px().cwiseProduct(
      search_sizes_.cwiseMax(Eigen::Vector2d::Constant(2.0)));
  return internal::ReachOf(Box2::FromCenter(box_px.center_px(), 2 * search_px));
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

void DcfTracker::FollowResponse() {
  const cv::Mat& response = filter_.Respond();
  colours_.Look(sampler_);
  const Eigen::Vector2d target_samples = SamplesOfCells(TargetCells());
  const cv::Mat* searched = &response;
  if (options_.colour_histogram > 0.0) {
    const int n = response.rows;
    const auto weight = static_cast<float>(options_.colour_histogram);
    for (int y = 0; y < n; ++y) {
      for (int x = 0; x < n; ++x) {
        const Eigen::Vector2d shift(x < n / 2 ? x : x - n,
                                    y < n / 2 ? y : y - n);
        merged_.at<float>(y, x) =
            (1.0F - weight) * response.at<float>(y, x) +
            weight * static_cast<float>(colours_.Likelihood(
                         SamplesOfCells(shift), target_samples));
      }
    }
    searched = &merged_;
  }
  internal::Peak peak = internal::FindPeak(*searched);
  if (options_.sub_cell) {
    peak = filter_.RefinedPeak(peak);
  } else {
    peak.shift_cells = peak.shift_cells.array().round();
  }
  signals_.peak = peak.value;
  signals_.sharpness = PeakToEnergy(response);
  signals_.sidelobe = PeakToSidelobe(response, peak);
  signals_.colour =
      colours_.Likelihood(SamplesOfCells(peak.shift_cells), target_samples);
  const Eigen::Vector2d cell_px = SearchSize() / options_.filter.cells;
  box_px_ = Box2::FromCenter(
      box_px_.center_px() + cell_px.cwiseProduct(peak.shift_cells),
      box_px_.size_px());
}

absl::StatusOr<TargetObservation> DcfTracker::Detect(const cv::Mat& image,
                                                     bool fixed_size) {
  if (!initialized_) {
    return absl::FailedPreconditionError("dcf: Detect before Initialize");
  }
  RETURN_IF_ERROR(internal::CheckImage(image));
  signals_ = {};
  scale_wanted_ = options_.scale && !fixed_size;
  if (internal::Touches(image, box_px_)) {
    ReadPatch(image);
    FollowResponse();
    if (scale_wanted_ && internal::Touches(image, box_px_)) Rescale(image);
  }
  recent_sharpness_ += kRecentRate * (signals_.sharpness - recent_sharpness_);
  return TargetObservation{box_px_, ConfidenceOfSharpness(signals_.sharpness)};
}

void DcfTracker::Learn(const cv::Mat& image) {
  if (!initialized_ || !options_.learns || !internal::CheckImage(image).ok() ||
      !internal::Touches(image, box_px_)) {
    return;
  }
  if (options_.learning_gate &&
      (signals_.sharpness < kLearnAbove ||
       signals_.sharpness < kLearnAboveRecent * recent_sharpness_)) {
    return;
  }
  ReadPatch(image);
  filter_.Update(TargetCells());
  colours_.Learn(sampler_, SamplesOfCells(TargetCells()), kColourRate);
  if (scale_wanted_) scale_filter_.Update(image, box_px_);
}

}  // namespace groundlock::target
