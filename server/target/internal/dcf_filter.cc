// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/dcf_filter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>

#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {
namespace {

constexpr int kLanes = LaneTransform::kLanes;
constexpr int kLaneFloats = LaneTransform::kCellFloats;
constexpr int kMostColumnFloats = 256;  // of a frequency

// A column of the frequencies of a training. Multipliers may be null, which are
// zero then; at first they are zero whatever they hold.
struct ColumnProblem {
  int cells, channels;
  const float *sample, *before, *filter, *desired;
  float* multiplier;
  bool first;
  float of_before, of_crop;
  // A column of each block, and the one that mirrors it, which may be the same.
  float* const* packed;
  float* const* mirror;
};

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
}  // namespace groundlock::target::internal

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::target::internal
#define GROUNDLOCK_KERNELS "server/target/internal/filter_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::target::internal {

DcfFilter::DcfFilter(const DcfFilterOptions& options)
    : options_(options), transform_(options.cells), plane_(options.cells) {
  const std::size_t cells = options.cells;
  patch_.resize(cells * cells * options.channels);
  packed_.resize(2 * cells * options.channels);
  const std::size_t values = Columns() * ColumnFloats();
  for (auto* spectrum : {&sample_, &filter_, &before_, &multiplier_}) {
    spectrum->resize(values);
  }
  desired_.resize(cells * Columns());
  row_turns_.resize(cells);
  cosines_.resize(cells);
  sines_.resize(cells);
  response_column_.resize(2UL * WholeVectors(options.cells));
  response_spectrum_.resize(desired_.size());
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
  if (std::abs(sigma - output_sigma_cells_) > 0.01 * sigma) SetOutput(sigma);
}

void DcfFilter::SetOutput(double sigma_cells) {
  output_sigma_cells_ = sigma_cells;
  const std::vector<double> axis =
      GaussianSpectrum(options_.cells, sigma_cells);
  for (int x = 0; x < Columns(); ++x) {
    for (int y = 0; y < options_.cells; ++y) {
      desired_[x * options_.cells + y] = static_cast<float>(axis[y] * axis[x]);
    }
  }
}

float* DcfFilter::Block(int block) {
  const std::size_t cells = options_.cells;
  return &patch_[block * cells * cells * kLaneFloats];
}

void DcfFilter::ClearCell(int x, int y) {
  for (int block = 0; block < options_.channels / kLaneFloats; ++block) {
    std::fill_n(Block(block) + (y * options_.cells + x) * kLaneFloats,
                kLaneFloats,
                0.0F);
  }
}

float* DcfFilter::Column(int block, bool mirror) {
  return &packed_[static_cast<std::size_t>(2 * block + (mirror ? 1 : 0)) *
                  options_.cells * kLaneFloats];
}

void DcfFilter::ToSpectrum(std::vector<float>& spectrum,
                           int first_row,
                           int end_row) {
  const int n = options_.cells;
  const int pitch = n * kLaneFloats;
  for (int block = 0; block < options_.channels / kLaneFloats; ++block) {
    float* cells = Block(block);
    std::fill(cells, cells + first_row * pitch, 0.0F);
    std::fill(cells + end_row * pitch, cells + n * pitch, 0.0F);
    for (int y = first_row; y < end_row; ++y) {
      transform_.Forward(
          cells + y * pitch, kLaneFloats, cells + y * pitch, kLaneFloats);
    }
    for (int x = 0; x < Columns(); ++x) {
      const int mirror_x = (n - x) % n;
      float* column = Column(block, /*mirror=*/false);
      float* mirror = column;
      transform_.Forward(cells + x * kLaneFloats, pitch, column, kLaneFloats);
      if (mirror_x != x) {
        mirror = Column(block, /*mirror=*/true);
        transform_.Forward(
            cells + mirror_x * kLaneFloats, pitch, mirror, kLaneFloats);
      }
      GROUNDLOCK_WIDEST(UnpackColumn)
      (column,
       mirror,
       n,
       options_.channels,
       &spectrum[x * ColumnFloats() + block * kLaneFloats]);
    }
  }
}

// A column of packed spectra to the block's rows that may differ from zero.
void DcfFilter::FromSpectrum(int x, int block) {
  const int n = options_.cells;
  const int mirror_x = (n - x) % n;
  for (const int to : {x, mirror_x}) {
    float* column = Column(block, to != x);
    transform_.Inverse(column, kLaneFloats, column, kLaneFloats);
    for (int y = crop_first_.y(); y < crop_end_.y(); ++y) {
      std::copy_n(column + y * kLaneFloats,
                  kLaneFloats,
                  Block(block) + (y * n + to) * kLaneFloats);
    }
    if (mirror_x == x) break;
  }
}

void DcfFilter::SolveFrequencies(double temporal, bool first, bool last) {
  const int n = options_.cells;
  const int blocks = options_.channels / kLaneFloats;
  std::array<float*, kMostColumnFloats / kLaneFloats> packed;
  std::array<float*, kMostColumnFloats / kLaneFloats> mirror;
  for (int x = 0; x < Columns(); ++x) {
    const bool mirrors_itself = x == (n - x) % n;
    for (int block = 0; block < blocks; ++block) {
      packed[block] = Column(block, /*mirror=*/false);
      mirror[block] = Column(block, !mirrors_itself);
    }
    const std::size_t at = x * ColumnFloats();
    GROUNDLOCK_WIDEST(SolveColumn)
    ({.cells = n,
      .channels = options_.channels,
      .sample = &sample_[at],
      .before = first ? &filter_[at] : &before_[at],
      .filter = &filter_[at],
      .desired = &desired_[static_cast<std::size_t>(x) * n],
      .multiplier = first && last ? nullptr : &multiplier_[at],
      .first = first,
      .of_before = static_cast<float>(temporal * n * n),
      .of_crop = static_cast<float>(options_.penalty * n * n),
      .packed = packed.data(),
      .mirror = mirror.data()});
    for (int block = 0; block < blocks; ++block) FromSpectrum(x, block);
  }
}

void DcfFilter::Crop() {
  const int n = options_.cells;
  const float scale = 1.0F / static_cast<float>(n * n);
  for (int block = 0; block < options_.channels / kLaneFloats; ++block) {
    for (int y = crop_first_.y(); y < crop_end_.y(); ++y) {
      float* row = Block(block) + static_cast<std::size_t>(y) * n * kLaneFloats;
      transform_.Inverse(row, kLaneFloats, row, kLaneFloats);
      std::fill(row, row + crop_first_.x() * kLaneFloats, 0.0F);
      for (int i = crop_first_.x() * kLaneFloats;
           i < crop_end_.x() * kLaneFloats;
           ++i) {
        row[i] *= scale;
      }
      std::fill(row + crop_end_.x() * kLaneFloats, row + n * kLaneFloats, 0.0F);
    }
  }
}

// From the filter that there is, which it shall stay near.
void DcfFilter::Solve(int iterations, double temporal) {
  if (iterations > 1) before_ = filter_;
  for (int i = 0; i < iterations; ++i) {
    const bool last = i + 1 == iterations;
    SolveFrequencies(temporal, i == 0, last);
    Crop();
    ToSpectrum(filter_, crop_first_.y(), crop_end_.y());
    if (last) break;  // nobody asks for the multipliers
    float* __restrict h = multiplier_.data();
    const float* __restrict g = filter_.data();
    for (std::size_t k = 0; k < multiplier_.size(); ++k) h[k] -= g[k];
  }
}

void DcfFilter::Train(const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ToSpectrum(sample_, 0, options_.cells);
  std::fill(filter_.begin(), filter_.end(), 0.0F);
  Solve(options_.first_iterations, 0.0);
}

void DcfFilter::Update(const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ToSpectrum(sample_, 0, options_.cells);
  Solve(options_.iterations, options_.temporal);
}

void DcfFilter::ShiftSample(const Eigen::Vector2d& shift_cells) {
  const int n = options_.cells;
  // The Nyquist terms, which have no sign, stay real.
  const auto turn = [n](int k, double shift) {
    const double angle =
        2.0 * std::numbers::pi * (k < n / 2 ? k : k - n) * shift / n;
    return k == n / 2 ? std::complex<double>(std::cos(angle), 0.0)
                      : std::polar(1.0, angle);
  };
  for (int y = 0; y < n; ++y) row_turns_[y] = turn(y, shift_cells.y());
  for (int x = 0; x < Columns(); ++x) {
    const std::complex<double> of_column = turn(x, shift_cells.x());
    for (int y = 0; y < n; ++y) {
      const std::complex<float> factor(row_turns_[y] * of_column);
      cosines_[y] = factor.real();
      sines_[y] = factor.imag();
    }
    GROUNDLOCK_WIDEST(TurnColumn)
    (cosines_.data(),
     sines_.data(),
     n,
     options_.channels,
     &sample_[x * ColumnFloats()]);
  }
}

void DcfFilter::UpdateSeen(const Eigen::Vector2d& shift_cells,
                           const Eigen::Vector2d& target_cells) {
  SetTarget(target_cells);
  ShiftSample(shift_cells);
  Solve(options_.iterations, options_.temporal);
}

const cv::Mat& DcfFilter::Respond() {
  ToSpectrum(sample_, 0, options_.cells);
  return RespondBy(filter_);
}

const cv::Mat& DcfFilter::RespondBy(const std::vector<float>& filter) {
  const int n = options_.cells;
  float* re = response_column_.data();
  float* im = re + WholeVectors(n);
  for (int x = 0; x < Columns(); ++x) {
    const std::size_t at = x * ColumnFloats();
    GROUNDLOCK_WIDEST(RespondColumn)
    (&filter[at], &sample_[at], n, options_.channels, re, im);
    for (int y = 0; y < n; ++y) {
      const std::complex<float> sum(re[y], im[y]);
      response_spectrum_[y * Columns() + x] = sum;
      plane_.Put(x, y, sum);
    }
  }
  plane_.Inverse(1.0F / static_cast<float>(n * n), response_.ptr<float>());
  return response_;
}

Peak DcfFilter::RefinedPeak(const Peak& coarse) const {
  const int n = options_.cells;
  const int columns = Columns();
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
