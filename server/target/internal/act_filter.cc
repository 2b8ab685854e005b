// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/act_filter.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "server/target/internal/spectrum.h"

namespace groundlock::target::internal {
namespace {

constexpr float kTiny = 1e-12F;  // 0 / 0 where the kernel's spectrum vanishes

}  // namespace

ActFilter::ActFilter(const ActOptions& options)
    : options_(options), cells_(options.model_cells) {
  const std::vector<float> hann = HannWindow(cells_);
  window_.reserve(static_cast<std::size_t>(cells_) * cells_);
  for (int y = 0; y < cells_; ++y) {
    for (int x = 0; x < cells_; ++x) window_.push_back(hann[y] * hann[x]);
  }
  ForwardTransform(
      PeriodicGaussian(cells_,
                       cells_ * options_.target_share * options_.output_sigma),
      desired_spectrum_);
  const int count = cells_ * cells_;
  names_.resize(count, kColourNames);
  intensity_.resize(count);
  for (Features* features : {&patch_features_, &model_features_}) {
    for (cv::Mat& plane : features->plane) {
      plane.create(cells_, cells_, CV_32F);
    }
  }
}

void ActFilter::ReadPatch(const PatchSampler& sampler) {
  const auto name_scale = static_cast<float>(options_.name_scale);
  const ColourNameTable& table = ColourNameTable::Get();
  const float* blue = sampler.plane(0).data();
  const float* green = sampler.plane(1).data();
  const float* red = sampler.plane(2).data();
  for (int i = 0; i < cells_ * cells_; ++i) {
    const ColourNameVector& names =
        table.At(static_cast<std::uint8_t>(cvRound(red[i])),
                 static_cast<std::uint8_t>(cvRound(green[i])),
                 static_cast<std::uint8_t>(cvRound(blue[i])));
    for (int name = 0; name < kColourNames; ++name) {
      names_(i, name) = name_scale * names[name];
    }
    // ITU-R BT.601 luma, centred as in the published tracker.
    intensity_[i] =
        (0.299F * red[i] + 0.587F * green[i] + 0.114F * blue[i]) / 255.0F -
        0.5F;
  }
}

void ActFilter::Project(const NameMatrix& names,
                        const Eigen::VectorXf& intensity,
                        Features& features) const {
  std::array<float*, kChannels> out;
  for (int c = 0; c < kChannels; ++c) {
    out[c] = features.plane[c].ptr<float>();
  }
  double energy = 0.0;
  for (int i = 0; i < cells_ * cells_; ++i) {
    const Eigen::Matrix<float, 1, kCompressed> compressed =
        names.row(i) * projection_ * window_[i];
    for (int c = 0; c < kCompressed; ++c) out[c][i] = compressed[c];
    out[kCompressed][i] = intensity[i] * window_[i];
    energy +=
        compressed.squaredNorm() + out[kCompressed][i] * out[kCompressed][i];
  }
  features.energy = energy;
  for (int c = 0; c < kChannels; ++c) {
    ForwardTransform(features.plane[c], features.spectrum[c]);
  }
}

// Gaussian kernel of x with every cyclic shift of z (eq. 4 and the text above
// it), as a spectrum.
void ActFilter::Kernel(const Features& x, const Features& z) {
  product_.create(cells_, cells_, CV_32FC2);
  product_.setTo(0.0);
  for (int c = 0; c < kChannels; ++c) {
    AddConjugateProduct(x.spectrum[c], z.spectrum[c], product_);
  }
  InverseTransform(product_, correlation_);
  const auto energy = static_cast<float>(x.energy + z.energy);
  const auto scale =
      static_cast<float>(-1.0 / (options_.kernel_sigma * options_.kernel_sigma *
                                 kChannels * cells_ * cells_));
  auto* value = correlation_.ptr<float>();
  for (int i = 0; i < cells_ * cells_; ++i) {
    value[i] = scale * std::max(0.0F, energy - 2.0F * value[i]);
  }
  cv::exp(correlation_, correlation_);
  ForwardTransform(correlation_, kernel_spectrum_);
}

const cv::Mat& ActFilter::Respond(const PatchSampler& sampler) {
  ReadPatch(sampler);
  Project(names_, intensity_, patch_features_);
  Kernel(patch_features_, model_features_);
  // alpha * kernel with alpha = numerator / denominator.
  const auto* k = kernel_spectrum_.ptr<cv::Vec2f>();
  const auto* n = numerator_.ptr<float>();
  const auto* d = denominator_.ptr<float>();
  auto* out = product_.ptr<cv::Vec2f>();
  for (int i = 0; i < cells_ * cells_; ++i) {
    const float alpha = n[i] / (d[i] + kTiny);
    out[i] = cv::Vec2f(alpha * k[i][0], alpha * k[i][1]);
  }
  InverseTransform(product_, response_);
  return response_;
}

void ActFilter::Train(const PatchSampler& sampler) {
  ReadPatch(sampler);
  learnt_names_ = names_;
  learnt_intensity_ = intensity_;
  smoothed_covariance_.setZero();
  numerator_ = cv::Mat::zeros(cells_, cells_, CV_32F);
  denominator_ = cv::Mat::zeros(cells_, cells_, CV_32F);
  Learn(1.0, 1.0);
}

void ActFilter::Update(const PatchSampler& sampler) {
  ReadPatch(sampler);
  const auto rate = static_cast<float>(options_.learning_rate);
  learnt_names_ += rate * (names_ - learnt_names_);
  learnt_intensity_ += rate * (intensity_ - learnt_intensity_);
  Learn(options_.learning_rate, options_.compression_learning_rate);
}

void ActFilter::Learn(double rate, double compression_rate) {
  UpdateProjection(compression_rate);
  Project(names_, intensity_, patch_features_);
  Kernel(patch_features_, patch_features_);
  const auto* spectrum = kernel_spectrum_.ptr<cv::Vec2f>();
  const auto* y = desired_spectrum_.ptr<cv::Vec2f>();
  auto* n = numerator_.ptr<float>();
  auto* d = denominator_.ptr<float>();
  const auto r = static_cast<float>(rate);
  const auto lambda = static_cast<float>(options_.lambda);
  for (int i = 0; i < cells_ * cells_; ++i) {
    // Both are symmetric about (0, 0), and a Gaussian kernel of a signal with
    // itself is positive definite: real spectra, the kernel's not negative.
    // What else there is is rounding, which the division would blow up.
    const float k = std::max(spectrum[i][0], 0.0F);
    n[i] += r * (y[i][0] * k - n[i]);
    d[i] += r * (k * (k + lambda) - d[i]);
  }
  Project(learnt_names_, learnt_intensity_, model_features_);
}

// Algorithm 1: the principal components of the learnt appearance's covariance,
// smoothed by the covariance that the earlier projections kept.
void ActFilter::UpdateProjection(double rate) {
  const Eigen::Matrix<float, 1, kColourNames> mean =
      learnt_names_.colwise().mean();
  Eigen::Matrix<float, kColourNames, kColourNames> scatter;
  scatter.noalias() = learnt_names_.transpose() * learnt_names_;
  const auto count = static_cast<double>(learnt_names_.rows());
  const Covariance covariance =
      (scatter.cast<double>() -
       count * mean.cast<double>().transpose() * mean.cast<double>()) /
      (count - 1.0);
  const Eigen::SelfAdjointEigenSolver<Covariance> solver(
      (1.0 - rate) * smoothed_covariance_ + rate * covariance);
  // Eigenvalues ascend: the last columns carry the most variance.
  const auto basis = solver.eigenvectors().rightCols<kCompressed>();
  const auto variances = solver.eigenvalues().tail<kCompressed>();
  projection_ = basis.cast<float>();
  smoothed_covariance_ =
      (1.0 - rate) * smoothed_covariance_ +
      rate * (basis * variances.asDiagonal() * basis.transpose());
}

}  // namespace groundlock::target::internal
