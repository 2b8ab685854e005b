// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/dcf_filter.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;
constexpr int kGroup = LaneTransform::kCellFloats;

// A Gaussian's spectrum on the periodic grid, real because it is even. One
// axis; the plane's is the product.
std::vector<double> GaussianSpectrum(int size, double sigma_cells) {
  std::vector<double> spectrum(size);
  for (int k = 0; k < size; ++k) {
    for (int x = 0; x < size; ++x) {
      const double d = std::min(x, size - x) / sigma_cells;
      spectrum[k] += std::exp(-0.5 * d * d) *
                     std::cos(2.0 * std::numbers::pi * k * x / size);
    }
  }
  return spectrum;
}

}  // namespace

DcfFilter::DcfFilter(const DcfFilterOptions& options)
    : options_(options), transform_(options.cells) {
  const std::size_t cells = options.cells;
  patch_.resize(cells * cells * options.channels);
  const std::size_t values = 2UL * options.channels * Frequencies();
  for (auto* spectrum : {&sample_, &filter_, &before_, &multiplier_}) {
    spectrum->resize(values);
  }
  desired_.resize(Frequencies());
  response_spectrum_.resize(Frequencies());
  response_.create(options.cells, options.cells, CV_32F);
}

void DcfFilter::SetTarget(const Eigen::Vector2d& target_cells) {
  for (int axis = 0; axis < 2; ++axis) {
    // At least two cells either way: a one-pixel target is still a place.
    const int half = options_.crop ? std::clamp(static_cast<int>(std::lround(
                                                    0.5 * target_cells[axis])),
                                                2,
                                                options_.cells / 2)
                                   : options_.cells / 2;
    crop_first_[axis] = options_.cells / 2 - half;
    crop_end_[axis] = options_.cells / 2 + half;
  }
  const double sigma =
      std::max(0.5, options_.output_sigma * std::sqrt(target_cells.prod()));
  if (std::abs(sigma - output_sigma_cells_) <= 0.01 * sigma) return;
  output_sigma_cells_ = sigma;
  const std::vector<double> axis = GaussianSpectrum(options_.cells, sigma);
  const int columns = options_.cells / 2 + 1;
  for (int y = 0; y < options_.cells; ++y) {
    for (int x = 0; x < columns; ++x) {
      desired_[y * columns + x] = static_cast<float>(axis[y] * axis[x]);
    }
  }
}

// Two channels travel as the real and the imaginary part of one lane; the
// symmetry of a real channel's spectrum tells them apart.
void DcfFilter::ToSpectrum(std::vector<float>& spectrum,
                           int first_row,
                           int end_row) {
  const int n = options_.cells;
  const int columns = n / 2 + 1;
  const int channels = options_.channels;
  for (int block = 0; block < channels / kGroup; ++block) {
    float* cells =
        patch_.data() + static_cast<std::size_t>(block) * n * n * kGroup;
    transform_.Forward(cells, first_row, end_row);
    for (int y = 0; y < n; ++y) {
      const int mirror_y = (n - y) % n;
      for (int x = 0; x < columns; ++x) {
        const int mirror_x = (n - x) % n;
        const float* __restrict z = cells + (y * n + x) * kGroup;
        const float* __restrict m = cells + (mirror_y * n + mirror_x) * kGroup;
        float* __restrict re = spectrum.data() +
                               2UL * channels * (y * columns + x) +
                               block * kGroup;
        float* __restrict im = re + channels;
        for (int i = 0; i < kLanes; ++i) {
          re[i] = 0.5F * (z[i] + m[i]);
          im[i] = 0.5F * (z[kLanes + i] - m[kLanes + i]);
          re[kLanes + i] = 0.5F * (z[kLanes + i] + m[kLanes + i]);
          im[kLanes + i] = 0.5F * (m[i] - z[i]);
        }
      }
    }
  }
}

// The way back, for one frequency and its mirror.
void DcfFilter::PackFrequency(int x, int y, const float* channels) {
  const int n = options_.cells;
  for (int block = 0; block < options_.channels / kGroup; ++block) {
    float* cells =
        patch_.data() + static_cast<std::size_t>(block) * n * n * kGroup;
    float* __restrict z = cells + (y * n + x) * kGroup;
    const float* __restrict re = channels + block * kGroup;
    const float* __restrict im = re + options_.channels;
    for (int i = 0; i < kLanes; ++i) {
      z[i] = re[i] - im[kLanes + i];
      z[kLanes + i] = im[i] + re[kLanes + i];
    }
    float* __restrict m = cells + ((n - y) % n * n + (n - x) % n) * kGroup;
    for (int i = 0; i < kLanes; ++i) {
      m[i] = re[i] + im[kLanes + i];
      m[kLanes + i] = re[kLanes + i] - im[i];
    }
  }
}

// f = argmin 1/2 |x^H f - y|^2 + a_t/2 |f - before|^2 + a_c/2 |f - g + h|^2 per
// frequency; leaves f + h in the multipliers and, packed, in the patch.
void DcfFilter::SolveFrequencies(double temporal) {
  const int n = options_.cells;
  const int columns = n / 2 + 1;
  const int channels = options_.channels;
  const float of_before = static_cast<float>(temporal * n * n);
  const float of_crop = static_cast<float>(options_.penalty * n * n);
  const float ridge = of_before + of_crop;
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < columns; ++x) {
      const std::size_t frequency = y * columns + x;
      const std::size_t at = 2UL * channels * frequency;
      const float* __restrict s = &sample_[at];
      const float* __restrict before = &before_[at];
      const float* __restrict g = &filter_[at];
      float* __restrict h = &multiplier_[at];
      // b = y x + a_t before + a_c (g - h), into h; x^H b and x^H x.
      float energy = 0.0F;
      float dot_re = 0.0F;
      float dot_im = 0.0F;
      const float desired = desired_[frequency];
      constexpr int kWide = 16;
      float partial[3][kWide] = {};
      float old_h[256];
      for (int i = 0; i < 2 * channels; ++i) {
        old_h[i] = h[i];
        h[i] = desired * s[i] + of_before * before[i] + of_crop * (g[i] - h[i]);
      }
      for (int c = 0; c < channels; c += kWide) {
        for (int i = 0; i < kWide; ++i) {
          const float sr = s[c + i];
          const float si = s[channels + c + i];
          const float br = h[c + i];
          const float bi = h[channels + c + i];
          partial[0][i] += sr * sr + si * si;
          partial[1][i] += sr * br + si * bi;
          partial[2][i] += sr * bi - si * br;
        }
      }
      for (int i = 0; i < kWide; ++i) {
        energy += partial[0][i];
        dot_re += partial[1][i];
        dot_im += partial[2][i];
      }
      const float share_re = dot_re / (ridge + energy);
      const float share_im = dot_im / (ridge + energy);
      const float inverse = 1.0F / ridge;
      for (int c = 0; c < channels; ++c) {
        const float sr = s[c];
        const float si = s[channels + c];
        h[c] = (h[c] - (sr * share_re - si * share_im)) * inverse + old_h[c];
        h[channels + c] =
            (h[channels + c] - (sr * share_im + si * share_re)) * inverse +
            old_h[channels + c];
      }
      PackFrequency(x, y, h);
    }
  }
}

void DcfFilter::Crop() {
  const int n = options_.cells;
  const float scale = 1.0F / static_cast<float>(n * n);
  for (int block = 0; block < options_.channels / kGroup; ++block) {
    float* cells =
        patch_.data() + static_cast<std::size_t>(block) * n * n * kGroup;
    transform_.Inverse(cells, crop_first_.y(), crop_end_.y());
    for (int y = crop_first_.y(); y < crop_end_.y(); ++y) {
      float* row = cells + static_cast<std::size_t>(y) * n * kGroup;
      std::fill(row, row + crop_first_.x() * kGroup, 0.0F);
      for (int i = crop_first_.x() * kGroup; i < crop_end_.x() * kGroup; ++i) {
        row[i] *= scale;
      }
      std::fill(row + crop_end_.x() * kGroup, row + n * kGroup, 0.0F);
    }
  }
}

void DcfFilter::Solve(int iterations, double temporal) {
  std::fill(multiplier_.begin(), multiplier_.end(), 0.0F);
  for (int i = 0; i < iterations; ++i) {
    SolveFrequencies(temporal);
    Crop();
    ToSpectrum(filter_, crop_first_.y(), crop_end_.y());
    float* __restrict h = multiplier_.data();
    const float* __restrict g = filter_.data();
    for (std::size_t k = 0; k < multiplier_.size(); ++k) h[k] -= g[k];
  }
}

void DcfFilter::Train(const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ToSpectrum(sample_, 0, options_.cells);
  std::fill(filter_.begin(), filter_.end(), 0.0F);
  std::fill(before_.begin(), before_.end(), 0.0F);
  Solve(options_.first_iterations, 0.0);
}

void DcfFilter::Update(const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ToSpectrum(sample_, 0, options_.cells);
  before_ = filter_;
  Solve(options_.iterations, options_.temporal);
}

void DcfFilter::ShiftSample(const Eigen::Vector2d& shift_cells) {
  const int n = options_.cells;
  const int columns = n / 2 + 1;
  const int channels = options_.channels;
  // The Nyquist terms, which have no sign, stay real.
  const auto turn = [n](int k, double shift) {
    const double angle =
        2.0 * std::numbers::pi * (k < n / 2 ? k : k - n) * shift / n;
    return k == n / 2 ? std::complex<double>(std::cos(angle), 0.0)
                      : std::polar(1.0, angle);
  };
  for (int y = 0; y < n; ++y) {
    const std::complex<double> of_row = turn(y, shift_cells.y());
    for (int x = 0; x < columns; ++x) {
      const std::complex<float> factor(of_row * turn(x, shift_cells.x()));
      const float c = factor.real();
      const float s = factor.imag();
      float* __restrict re = &sample_[2UL * channels * (y * columns + x)];
      float* __restrict im = re + channels;
      for (int i = 0; i < channels; ++i) {
        const float turned = re[i] * c - im[i] * s;
        im[i] = re[i] * s + im[i] * c;
        re[i] = turned;
      }
    }
  }
}

void DcfFilter::UpdateSeen(const Eigen::Vector2d& shift_cells,
                           const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ShiftSample(shift_cells);
  before_ = filter_;
  Solve(options_.iterations, options_.temporal);
}

const cv::Mat& DcfFilter::Respond() {
  ToSpectrum(sample_, 0, options_.cells);
  return RespondBy(filter_);
}

const cv::Mat& DcfFilter::RespondBy(const std::vector<float>& filter) {
  const int n = options_.cells;
  const int columns = n / 2 + 1;
  const int channels = options_.channels;
  // The transform back takes one lane of the patch, which is used up.
  std::fill(patch_.begin(), patch_.begin() + n * n * kGroup, 0.0F);
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < columns; ++x) {
      const std::size_t frequency = y * columns + x;
      const float* __restrict f = &filter[2UL * channels * frequency];
      const float* __restrict s = &sample_[2UL * channels * frequency];
      constexpr int kWide = 16;
      float re[kWide] = {};
      float im[kWide] = {};
      for (int c = 0; c < channels; c += kWide) {
        for (int i = 0; i < kWide; ++i) {
          const float fr = f[c + i];
          const float fi = f[channels + c + i];
          const float sr = s[c + i];
          const float si = s[channels + c + i];
          re[i] += fr * sr + fi * si;
          im[i] += fr * si - fi * sr;
        }
      }
      std::complex<float> sum = 0.0F;
      for (int i = 0; i < kWide; ++i) sum += std::complex<float>(re[i], im[i]);
      response_spectrum_[frequency] = sum;
      float* cell = patch_.data() + (y * n + x) * kGroup;
      float* mirror = patch_.data() + ((n - y) % n * n + (n - x) % n) * kGroup;
      cell[0] = mirror[0] = sum.real();
      cell[kLanes] = sum.imag();
      mirror[kLanes] = -sum.imag();
    }
  }
  transform_.Inverse(patch_.data(), 0, n);
  const float scale = 1.0F / static_cast<float>(n * n);
  auto* response = response_.ptr<float>();
  for (int i = 0; i < n * n; ++i) response[i] = scale * patch_[i * kGroup];
  return response_;
}

Peak DcfFilter::RefinedPeak(const Peak& coarse) const {
  const int n = options_.cells;
  const int columns = n / 2 + 1;
  constexpr int kSteps = 4;
  Eigen::Vector2d at = coarse.shift_cells;
  const double unit = 2.0 * std::numbers::pi / n;
  double value = coarse.value;
  Peak best = coarse;
  for (int step = 0; step < kSteps; ++step) {
    // r(s) = 1/n^2 sum_k R(k) e^(i unit k.s), its gradient and its Hessian. The
    // Nyquist terms, which have no sign, are left out.
    value = 0.0;
    Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
    double xx = 0.0;
    double xy = 0.0;
    double yy = 0.0;
    const std::complex<double> turn = std::polar(1.0, unit * at.x());
    for (int y = 0; y < n; ++y) {
      if (y == n / 2) continue;
      const double ky = unit * (y < n / 2 ? y : y - n);
      std::complex<double> wave = std::polar(1.0, ky * at.y());
      for (int x = 0; x < columns - 1; ++x) {
        const double kx = unit * x;
        const std::complex<float>& r = response_spectrum_[y * columns + x];
        const double weight = x == 0 ? 1.0 : 2.0;
        const double re =
            weight * (r.real() * wave.real() - r.imag() * wave.imag());
        const double im =
            weight * (r.real() * wave.imag() + r.imag() * wave.real());
        value += re;
        gradient.x() -= kx * im;
        gradient.y() -= ky * im;
        xx -= kx * kx * re;
        xy -= kx * ky * re;
        yy -= ky * ky * re;
        wave = {wave.real() * turn.real() - wave.imag() * turn.imag(),
                wave.real() * turn.imag() + wave.imag() * turn.real()};
      }
    }
    value /= static_cast<double>(n) * n;
    if (value > best.value || step == 0) best = {at, value};
    const double determinant = xx * yy - xy * xy;
    if (xx >= 0.0 || determinant <= 0.0) break;  // no maximum here
    const Eigen::Vector2d delta{
        (yy * gradient.x() - xy * gradient.y()) / determinant,
        (xx * gradient.y() - xy * gradient.x()) / determinant};
    at -= delta;
    if ((at - coarse.shift_cells).cwiseAbs().maxCoeff() > 1.0) break;
    if (delta.norm() < 1e-3) break;
  }
  return best;
}

}  // namespace groundlock::target::internal
