// SPDX-License-Identifier: Apache-2.0
#include "server/target/dcf_tracker.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <utility>

#include "map_store/base/status.h"
#include "server/target/internal/input_check.h"
#include "server/target/internal/response_peaks.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

// See the header for where these come from.
constexpr double kSharpnessSlope = 1.72;
constexpr double kSharpnessOffset = -4.27;
constexpr double kLearnAbove = 10.0;
constexpr double kLearnAboveRecentSharpness = 0.25;
constexpr double kRecentRate = 0.2;

double ConfidenceOf(const DcfSignals& signals) {
  if (!(signals.sharpness > 0.0)) return 0.0;
  return 1.0 / (1.0 + std::exp(-(kSharpnessSlope * std::log(signals.sharpness) +
                                 kSharpnessOffset)));
}

// Where the target is searched for, all else looks more like it than where it
// is followed; there the sidelobes and the colours tell the two apart twice as
// often as the sharpness does, at the same rate of false alarms.
constexpr double kRecognitionSlope = 2.18;
constexpr double kRecognitionOffset = -5.11;
constexpr double kRecognitionColour = 0.15;

double LogOdds(double probability) {
  const double p = std::clamp(probability, 1e-4, 1.0 - 1e-4);
  return std::log(p / (1.0 - p));
}

double RecognitionOf(const DcfSignals& signals) {
  if (!(signals.sidelobe > 0.0)) return 0.0;
  const double colour =
      LogOdds(signals.colour) - LogOdds(signals.expected_colour);
  const double looks =
      std::log(std::max(signals.sidelobe, 1.0)) + kRecognitionColour * colour;
  return 1.0 /
         (1.0 + std::exp(-(kRecognitionSlope * looks + kRecognitionOffset)));
}

constexpr double kColourRate = 0.01;
// An occluder that slides over the target makes the response and the target's
// colours fade together within a second: both have fallen below this share of
// their means over so many frames.
constexpr double kFadedShare = 0.75;
constexpr int kUsualFrames = 30;

}  // namespace

DcfTracker::DcfTracker(const DcfTrackerOptions& options)
    : options_(options),
      sampler_(options_.filter.cells * internal::GradientHistogram::kCellPx),
      features_(options_.filter.cells, options_.colour_names),
      filter_(options_.filter),
      colours_(sampler_.cells()),
      scale_filter_(internal::kCoarseSteps),
      growth_filter_(internal::kFineSteps),
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

void DcfTracker::ClearLeftOut() {
  const int n = options_.filter.cells;
  const Eigen::Vector2d cell_px = SearchSize() / n;
  const Eigen::Vector2d first_px = box_px_.center_px() - 0.5 * SearchSize();
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      const Eigen::Vector2d center_px =
          first_px + cell_px.cwiseProduct(Eigen::Vector2d(x + 0.5, y + 0.5));
      const bool is_left_out =
          std::any_of(left_out_px_.begin(),
                      left_out_px_.end(),
                      [&](const geometry::ConvexPolygon& part_px) {
                        return part_px.Contains(center_px);
                      });
      if (is_left_out) filter_.ClearCell(x, y);
    }
  }
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
  looked_px_ = box_px_;
  colours_.LookForBoxes(sampler_);
  outline_.Start(colours_, ToSamples(box_px_));
  scale_filter_.Train(image, box_px_);
  growth_filter_.Train(image, box_px_);
  initialized_ = true;
  signals_ = {};
  recent_sharpness_ = 0.0;
  usual_peak_ = 0.0;
  usual_excess_ = 0.0;
  usual_frames_ = 0;
  expectation_.reset();
  left_out_px_.clear();
  recalled_.clear();
  decided_ = nullptr;
  looked_px_.reset();
  return absl::OkStatus();
}

Box2 DcfTracker::DetectBox(const Box2& box_px) const {
  // A search ends half its size aside at most; the scale is looked for there.
  // So far, too, the target mostly is from where it is learnt then.
  return internal::ReachOf(
      Box2::FromCenter(box_px.center_px(),
                       box_px.size_px().cwiseProduct(
                           search_sizes_ + Eigen::Vector2d::Constant(
                                               internal::ScaleFilter::kSpan))),
      sampler_.cells());
}

Box2 DcfTracker::LearnBox(const Box2& box_px) const {
  return internal::ReachOf(
      Box2::FromCenter(
          box_px.center_px(),
          box_px.size_px().cwiseProduct(search_sizes_.cwiseMax(
              Eigen::Vector2d::Constant(internal::ScaleFilter::kSpan)))),
      sampler_.cells());
}

int DcfTracker::Halvings(const Box2& box_px) const {
  return sampler_.Halvings(box_px.size_px().cwiseProduct(search_sizes_));
}

void DcfTracker::Place(const Box2& box_px) {
  if (internal::IsUsable(box_px)) box_px_ = box_px;
}

void DcfTracker::Resize(const cv::Mat& image, const Box2& box_px) {
  const Eigen::Vector2d size_px = box_px.size_px();
  const Eigen::Vector2d growth = size_px - box_px_.size_px();
  // A target neither vanishes between the pixels nor outgrows the image.
  if (size_px.minCoeff() < 2.0 && growth.minCoeff() < 0.0) return;
  if ((size_px.x() > image.cols && growth.x() > 0.0) ||
      (size_px.y() > image.rows && growth.y() > 0.0)) {
    return;
  }
  box_px_ = box_px;
}

void DcfTracker::Rescale(const cv::Mat& image) {
  const double factor = scale_filter_.Estimate(image, box_px_);
  Resize(image,
         Box2::FromCenter(box_px_.center_px(), factor * box_px_.size_px()));
}

Eigen::Vector2d DcfTracker::SamplesPerPixel() const {
  return sampler_.cells() *
         looked_px_->size_px().cwiseProduct(search_sizes_).cwiseInverse();
}

Box2 DcfTracker::ToSamples(const Box2& box_px) const {
  const Eigen::Vector2d scale = SamplesPerPixel();
  const Eigen::Vector2d shift = box_px.center_px() - looked_px_->center_px();
  return Box2::FromCenter(
      scale.cwiseProduct(shift).array() + 0.5 * sampler_.cells(),
      scale.cwiseProduct(box_px.size_px()));
}

void DcfTracker::FitOutline(const cv::Mat& image) {
  // Of a target that the image's edge cuts, colours see a part; and where it
  // fades or is hardly to be seen, they are of what hides it.
  const Box2 all = Box2::FromXywh(0.0, 0.0, image.cols, image.rows);
  if (!options_.colour_outline || !MayLearn() ||
      Intersection(all, box_px_).Area() < box_px_.Area()) {
    return;
  }
  colours_.LookForBoxes(sampler_);
  const Box2 found = ToSamples(box_px_);
  const Box2 fitted = outline_.Correct(colours_, found);
  fitted_outline_ = true;
  const Eigen::Vector2d scale = SamplesPerPixel();
  Resize(image,
         Box2::FromCenter(
             box_px_.center_px() +
                 (fitted.center_px() - found.center_px()).cwiseQuotient(scale),
             fitted.size_px().cwiseQuotient(scale)));
}

void DcfTracker::Expect(const Eigen::Vector2d& center_px,
                        const Eigen::Matrix2d& covariance_px2) {
  // No prediction is better than this share of the target's side.
  constexpr double kLeastSigma = 0.1;
  const double sigma_px = kLeastSigma * std::sqrt(box_px_.size_px().prod());
  const Eigen::Matrix2d covariance =
      covariance_px2 + sigma_px * sigma_px * Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d information = covariance.inverse();
  expectation_.reset();
  if (!center_px.allFinite() || !information.allFinite()) return;
  expectation_ = Expectation{center_px, information};
}

Eigen::Vector2d DcfTracker::Reach(const Box2& box_px) const {
  // The window halves what lies half of this way to the search's edge.
  constexpr double kReach = 0.2;
  return kReach * box_px.size_px().cwiseProduct(search_sizes_);
}

internal::Peak DcfTracker::FindPeak(const cv::Mat& response) const {
  if (!expectation_) return internal::FindPeak(response);
  return internal::FindExpectedPeak(
      response,
      {.offset_px = box_px_.center_px() - expectation_->center_px,
       .information = expectation_->information,
       .cell_px = SearchSize() / options_.filter.cells,
       .target_cells = TargetCells()});
}

void DcfTracker::Keep(std::unique_ptr<Appearance>& kept) const {
  if (!initialized_) return;
  auto* appearance = dynamic_cast<KeptAppearance*>(kept.get());
  if (appearance == nullptr) {
    auto made = std::make_unique<KeptAppearance>();
    appearance = made.get();
    kept = std::move(made);
  }
  appearance->filter = filter_.filter();
  appearance->recent_sharpness = recent_sharpness_;
}

void DcfTracker::Recall(std::span<const Appearance* const> others) {
  recalled_.clear();
  for (const Appearance* other : others) {
    const auto* kept = dynamic_cast<const KeptAppearance*>(other);
    if (kept != nullptr) recalled_.push_back(kept);
  }
}

void DcfTracker::Adopt() {
  if (decided_ == nullptr) return;
  filter_.SetFilter(decided_->filter);
  recent_sharpness_ = decided_->recent_sharpness;
  usual_frames_ = 0;
  decided_ = nullptr;
}

const cv::Mat& DcfTracker::Respond() {
  const cv::Mat* response = &filter_.Respond();
  const KeptAppearance* last = nullptr;
  double sharpest = recalled_.empty() ? 0.0 : internal::PeakToEnergy(*response);
  for (const KeptAppearance* kept : recalled_) {
    response = &filter_.RespondBy(kept->filter);
    last = kept;
    const double sharpness = internal::PeakToEnergy(*response);
    if (sharpness <= sharpest) continue;
    sharpest = sharpness;
    decided_ = kept;
  }
  if (last == decided_) return *response;
  return filter_.RespondBy(decided_ != nullptr ? decided_->filter
                                               : filter_.filter());
}

void DcfTracker::FollowResponse() {
  const cv::Mat& response = Respond();
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
  internal::Peak peak = FindPeak(*searched);
  if (options_.sub_cell) {
    peak = filter_.RefinedPeak(peak);
  } else {
    peak.shift_cells = peak.shift_cells.array().round();
  }
  signals_.peak = peak.value;
  signals_.usual_peak = usual_frames_ > 0 ? usual_peak_ : peak.value;
  signals_.sharpness = internal::PeakToEnergy(response);
  signals_.sidelobe = internal::PeakToSidelobe(response, peak);
  signals_.colour =
      colours_.Likelihood(SamplesOfCells(peak.shift_cells), target_samples);
  signals_.expected_colour = colours_.expected();
  signals_.around_colour = colours_.around();
  signals_.excess_colour =
      std::max(0.0, signals_.colour - signals_.around_colour);
  signals_.usual_excess =
      usual_frames_ > 0 ? usual_excess_ : signals_.excess_colour;
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
  decided_ = nullptr;
  looked_px_.reset();
  scale_box_px_.reset();
  fitted_outline_ = false;
  if (internal::Touches(image, box_px_)) {
    ReadPatch(image);
    if (!left_out_px_.empty()) ClearLeftOut();
    looked_px_ = box_px_;
    FollowResponse();
    if (options_.scale && !fixed_size && internal::Touches(image, box_px_)) {
      Rescale(image);
      FitOutline(image);
      scale_box_px_ = box_px_;
      measures_growth_ = false;
    }
  }
  expectation_.reset();
  left_out_px_.clear();
  recalled_.clear();
  return TargetObservation{
      box_px_, ConfidenceOf(signals_), RecognitionOf(signals_)};
}

std::optional<double> DcfTracker::MeasureGrowth(const cv::Mat& image,
                                                const Box2& box_px) {
  if (!initialized_ || !options_.scale || !internal::CheckImage(image).ok() ||
      !internal::IsUsable(box_px) || !internal::Touches(image, box_px)) {
    return std::nullopt;
  }
  const double growth = growth_filter_.Estimate(image, box_px);
  measures_growth_ = true;
  scale_box_px_ =
      Box2::FromCenter(box_px.center_px(), growth * box_px.size_px());
  return growth;
}

std::optional<Eigen::Vector2d> DcfTracker::SeenShift() const {
  if (!looked_px_ || !looked_px_->size_px().isApprox(box_px_.size_px(), 1e-9)) {
    return std::nullopt;
  }
  const Eigen::Vector2d cell_px = SearchSize() / options_.filter.cells;
  const Eigen::Vector2d shift_cells =
      (box_px_.center_px() - looked_px_->center_px()).cwiseQuotient(cell_px);
  if (!(shift_cells.cwiseAbs().maxCoeff() <= options_.seen_cells)) {
    return std::nullopt;
  }
  return shift_cells;
}

bool DcfTracker::MayLearn() const {
  const bool fades =
      signals_.peak < kFadedShare * signals_.usual_peak &&
      signals_.excess_colour < kFadedShare * signals_.usual_excess;
  return !fades && signals_.sharpness >= kLearnAbove &&
         signals_.sharpness >= kLearnAboveRecentSharpness * recent_sharpness_;
}

void DcfTracker::RememberUsual() {
  recent_sharpness_ += kRecentRate * (signals_.sharpness - recent_sharpness_);
  usual_frames_ = std::min(usual_frames_ + 1, kUsualFrames);
  usual_peak_ += (signals_.peak - usual_peak_) / usual_frames_;
  usual_excess_ += (signals_.excess_colour - usual_excess_) / usual_frames_;
}

void DcfTracker::Learn(const cv::Mat& image) {
  if (!initialized_ || !options_.learns || !internal::CheckImage(image).ok() ||
      !internal::Touches(image, box_px_)) {
    return;
  }
  const bool may_learn = !options_.learning_gate || MayLearn();
  RememberUsual();
  if (!may_learn) return;
  if (const auto shift_cells = SeenShift()) {
    filter_.UpdateSeen(*shift_cells, TargetCells());
  } else {
    ReadPatch(image);
    filter_.Update(TargetCells());
  }
  looked_px_.reset();
  colours_.Learn(sampler_, SamplesOfCells(TargetCells()), kColourRate);
  if (fitted_outline_) outline_.Learn();
  if (!scale_box_px_) return;
  (measures_growth_ ? growth_filter_ : scale_filter_)
      .Update(image, *scale_box_px_);
}

}  // namespace groundlock::target
