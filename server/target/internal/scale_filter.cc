// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/scale_filter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace groundlock::target::internal {
namespace {

constexpr float kLearningRate = 0.025F;
constexpr float kLambda = 0.01F;

}  // namespace
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/scale_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

ScaleFilter::ScaleFilter(const ScaleSteps& steps)
    : steps_(steps),
      sampler_(kPatchSide),
      histogram_(kModelCells),
      features_(kModelCells * kRowFloats),
      samples_(kScales, kDimensions) {
  // The kernel reads less than three samples beyond either end.
  static_assert(kFineSteps.patch_span * (1.0 + 6.0 / kPatchSide) < kSpan);
  static_assert(kCoarseSteps.patch_span * (1.0 + 6.0 / kPatchSide) < kSpan);
  for (auto& plane : patch_columns_) plane.resize(kPatchSide * kPatchSide);
  for (auto& plane : model_) plane.resize(kModelSide * kModelSide);
  SetPlaces();
  numerator_.setZero(2 * kFrequencies, kDimensions);
  denominator_.setZero();
  // The desired output is a Gaussian of one scale step (17 / 16 in the paper's
  // units) about the middle scale; its spectrum is real about that.
  constexpr double kSigma = kScales / 16.0;
  constexpr int kMiddle = kScales / 2;
  for (int k = 0; k < kFrequencies; ++k) {
    double sum = 0.0;
    for (int s = 0; s < kScales; ++s) {
      const double d = s - kMiddle;
      const double angle = 2.0 * std::numbers::pi * k * d / kScales;
      sum += std::exp(-0.5 * d * d / (kSigma * kSigma)) * std::cos(angle);
      const double window =
          0.5 *
          (1.0 - std::cos(2.0 * std::numbers::pi * (s + 1) / (kScales + 1)));
      transform_(k, s) = static_cast<float>(window * std::cos(angle));
      transform_(kFrequencies + k, s) =
          static_cast<float>(-window * std::sin(angle));
    }
    desired_[k] = static_cast<float>(sum);
  }
}

// Where each scale reads the patch: kModelSide points about its centre.
void ScaleFilter::SetPlaces() {
  for (int s = 0; s < kScales; ++s) {
    const double extent =
        kPatchSide / steps_.patch_span * std::pow(steps_.step, s - kScales / 2);
    const double step = extent / kModelSide;
    const double first = 0.5 * (kPatchSide - extent) + 0.5 * step - 0.5;
    for (int i = 0; i < kModelSide; ++i) {
      const double at = std::clamp(first + i * step, 0.0, kPatchSide - 1.001);
      places_[s].index[i] = static_cast<int>(at);
      places_[s].share[i] = static_cast<float>(at - places_[s].index[i]);
    }
  }
}

// The content at one scale, read bilinearly: columns of the patch first.
void ScaleFilter::ReadScale(const Places& places) {
  std::array<float, kModelSide * kPatchSide> columns;
  std::array<float, kModelSide * kPatchSide> rows;
  for (int c = 0; c < 3; ++c) {
    GROUNDLOCK_WIDEST(ReadBetween)
    (patch_columns_[c].data(),
     kPatchSide,
     kModelSide,
     places.index.data(),
     places.share.data(),
     columns.data());
    GROUNDLOCK_WIDEST(TransposePlane)
    (columns.data(), kPatchSide, kModelSide, rows.data());
    GROUNDLOCK_WIDEST(ReadBetween)
    (rows.data(),
     kModelSide,
     kModelSide,
     places.index.data(),
     places.share.data(),
     model_[c].data());
  }
}

void ScaleFilter::Sample(const cv::Mat& image, const geometry::Box2& box_px) {
  sampler_.Sample(
      image,
      geometry::Box2::FromCenter(box_px.center_px(),
                                 steps_.patch_span * box_px.size_px()));
  for (int c = 0; c < 3; ++c) {
    GROUNDLOCK_WIDEST(TransposePlane)
    (sampler_.plane(c).data(),
     kPatchSide,
     kPatchSide,
     patch_columns_[c].data());
  }
  const std::array<const float*, 3> planes = {
      model_[0].data(), model_[1].data(), model_[2].data()};
  for (int s = 0; s < kScales; ++s) {
    ReadScale(places_[s]);
    histogram_.Compute(planes.data(), features_.data(), kRowFloats);
    for (int y = 0; y < kModelCells; ++y) {
      GROUNDLOCK_WIDEST(CellByCell)
      (&features_[y * kRowFloats],
       GradientHistogram::kFeatures,
       kFeaturePitch,
       kModelCells,
       &samples_(s, y * kModelCells * GradientHistogram::kFeatures));
    }
  }
  spectrum_.noalias() = transform_ * samples_;
}

void ScaleFilter::Learn(float rate) {
  const Line energy =
      (spectrum_.topRows<kFrequencies>().rowwise().squaredNorm() +
       spectrum_.bottomRows<kFrequencies>().rowwise().squaredNorm());
  for (int k = 0; k < kFrequencies; ++k) {
    for (const int row : {k, kFrequencies + k}) {
      numerator_.row(row) = (1.0F - rate) * numerator_.row(row) +
                            (rate * desired_[k]) * spectrum_.row(row);
    }
  }
  denominator_ = (1.0F - rate) * denominator_ + rate * energy;
}

void ScaleFilter::Train(const cv::Mat& image, const geometry::Box2& box_px) {
  Sample(image, box_px);
  Learn(1.0F);
}

void ScaleFilter::Update(const cv::Mat& image, const geometry::Box2& box_px) {
  Sample(image, box_px);
  Learn(kLearningRate);
}

double ScaleFilter::Estimate(const cv::Mat& image,
                             const geometry::Box2& box_px) {
  Sample(image, box_px);
  // conj(filter) * sample, per frequency.
  Line re, im;
  for (int k = 0; k < kFrequencies; ++k) {
    const auto nr = numerator_.row(k);
    const auto ni = numerator_.row(kFrequencies + k);
    const auto sr = spectrum_.row(k);
    const auto si = spectrum_.row(kFrequencies + k);
    re[k] = (nr.dot(sr) + ni.dot(si)) / (denominator_[k] + kLambda);
    im[k] = (nr.dot(si) - ni.dot(sr)) / (denominator_[k] + kLambda);
  }
  const auto response = [&](double scale) {
    double sum = re[0];
    for (int k = 1; k < kFrequencies; ++k) {
      const double angle = 2.0 * std::numbers::pi * k * scale / kScales;
      sum += 2.0 * (re[k] * std::cos(angle) - im[k] * std::sin(angle));
    }
    return sum;
  };
  // Half steps first, then the parabola through the best and its neighbours.
  constexpr int kHalfSteps = kScales - 1;
  double best = 0.0;
  double best_value = response(0.0);
  for (int i = -kHalfSteps; i <= kHalfSteps; ++i) {
    const double value = response(0.5 * i);
    if (value > best_value) {
      best_value = value;
      best = 0.5 * i;
    }
  }
  const double left = response(best - 0.5);
  const double right = response(best + 0.5);
  const double curvature = left - 2.0 * best_value + right;
  if (curvature < 0.0) {
    best += 0.5 * std::clamp(0.5 * (left - right) / curvature, -0.5, 0.5);
  }
  return std::pow(steps_.step, std::clamp(best, -8.0, 8.0));
}

}  // namespace groundlock::target::internal
