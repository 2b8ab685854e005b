// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/blurred_patch.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "server/image/vectors.h"

namespace groundlock::localization {
namespace {

constexpr int kHalf = 6;
constexpr int kSide = 2 * kHalf + 1;
// How far from its start a patch is searched.
constexpr int kReachPx = 4;
constexpr int kRegion = kSide + 2 * kReachPx;
constexpr int kMaxIterations = 10;
constexpr double kEpsilonPx = 0.01;
// Shorter blurs are no more than what the lens and the pixels do.
constexpr double kMinBlurPx = 0.7;
constexpr double kMaxBlurPx = 64.0;
constexpr double kTapSpacingPx = 1.25;
// Blurs that differ by less need no equalising, which costs detail.
constexpr double kSimilarBlurPx = 1.5;
constexpr double kMinCorrelation = 0.7;
// Places nearer to the last pixels than that count as if they were so far away.
constexpr double kBeforeLast = 1e-3;

// Rows of samples, each followed by zeros up to whole vectors. After the last
// row there is room for a vector that begins in it.
template <int kSamples>
struct Square {
  static constexpr int kSide = kSamples;
  static constexpr int kPitch = image::WholeVectors(kSamples);
  alignas(
      32) std::array<float, kSamples * kPitch + image::kVectorFloats> values{};
};

bool IsWithin(const cv::Mat& image, const Eigen::Vector2d& point) {
  return point.x() >= 0.0 && point.y() >= 0.0 && point.x() < image.cols - 1 &&
         point.y() < image.rows - 1;
}

// A square of samples along slanting axes: the one in column i and row k is at
// first + i * along + k * down, in pixels from the one at `origin`. Of places
// beyond (0, 0) and `last`, these are taken.
struct SlantingSquare {
  const unsigned char* origin = nullptr;
  std::ptrdiff_t step = 0;  // to the next row of the image
  std::array<float, 2> first, along, down, last;
};

constexpr int kPatchPitch = Square<kSide>::kPitch;

// Sums of the samples of a Square<kSamples>. Of the vectors of a row the last
// one ends with the samples, and overlaps the one before.
template <int kSamples>
struct UprightSums {
  static constexpr int kSide = kSamples;
  static constexpr int kVectors =
      image::WholeVectors(kSide) / image::kVectorFloats;
  static constexpr int kPitch = Square<kSide>::kPitch;
  static constexpr int FirstColumn(int vector) {
    return std::min(vector * image::kVectorFloats,
                    kSide - image::kVectorFloats);
  }
  alignas(32) std::array<float, kSide * kPitch> values{};
};

// What is looked for, within the rows of a Square<kSide>.
struct TakenPatch {
  // Of two of dx, dy, value and 1: xx, xy, xv, x, yy, yv, y, vv, v.
  static constexpr int kMoments = 9;
  using Rows = std::array<float, kSide * kPatchPitch>;
  alignas(32) Rows dx;
  alignas(32) Rows dy;
  alignas(32) Rows value;  // less their mean
  float mean = 0.0F;
  std::array<float, kMoments> moments;
};

}  // namespace
}  // namespace groundlock::localization

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::localization
#define GROUNDLOCK_KERNELS \
  "server/localization/follow/blurred_patch_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::localization {
namespace {

// Places along a blur whose mean stands for it, relative to its middle.
struct Taps {
  int count = 1;
  Eigen::Vector2d first = Eigen::Vector2d::Zero();
  Eigen::Vector2d step = Eigen::Vector2d::Zero();
};

Taps TapsAlong(const Eigen::Vector2d& blur) {
  Taps taps;
  const double length_px = blur.norm();
  if (length_px < kMinBlurPx) return taps;
  taps.count =
      std::max(2, static_cast<int>(std::ceil(length_px / kTapSpacingPx)));
  taps.step = blur / taps.count;
  taps.first = -0.5 * (taps.count - 1) * taps.step;
  return taps;
}

// Whether samples at center + axes * offset, averaged along `blur`, all lie in
// the image.
bool HoldsSquare(const cv::Mat& image,
                 double radius,
                 const Eigen::Vector2d& center,
                 const Eigen::Matrix2d& axes,
                 const Eigen::Vector2d& blur) {
  for (const double x : {-radius, radius}) {
    for (const double y : {-radius, radius}) {
      const Eigen::Vector2d corner = center + axes * Eigen::Vector2d(x, y);
      if (!IsWithin(image, corner - 0.5 * blur) ||
          !IsWithin(image, corner + 0.5 * blur)) {
        return false;
      }
    }
  }
  return true;
}

// Samples at center + offset, averaged along `blur`; false if one is outside of
// the image.
template <int kSamples>
bool SampleSquare(const cv::Mat& image,
                  const Eigen::Vector2d& center,
                  const Eigen::Vector2d& blur,
                  Square<kSamples>& square) {
  if (!HoldsSquare(image,
                   kSamples / 2,  // NOLINT(bugprone-integer-division)
                   center,
                   Eigen::Matrix2d::Identity(),
                   blur)) {
    return false;
  }
  constexpr double kRadius = kSamples / 2;
  using Sums = UprightSums<kSamples>;
  const auto step = static_cast<std::ptrdiff_t>(image.step[0]);
  const Taps taps = TapsAlong(blur);
  Sums sums;
  for (int tap = 0; tap < taps.count; ++tap) {
    const Eigen::Vector2d top_left =
        (center + taps.first + tap * taps.step).array() - kRadius;
    const auto x = static_cast<std::ptrdiff_t>(top_left.x());
    const auto y = static_cast<std::ptrdiff_t>(top_left.y());
    GROUNDLOCK_WIDEST(AddUprightSquare<Sums>)
    (image.ptr<unsigned char>() + y * step + x,
     step,
     static_cast<float>(top_left.x() - static_cast<double>(x)),
     static_cast<float>(top_left.y() - static_cast<double>(y)),
     sums);
  }
  const auto count = static_cast<float>(taps.count);
  for (int row = 0; row < kSamples; ++row) {
    const int at = row * Sums::kPitch;
    for (int i = 0; i < Sums::kVectors; ++i) {
      const float* from = sums.values.data() + at + i * image::kVectorFloats;
      float* to = square.values.data() + at + Sums::FirstColumn(i);
      for (int k = 0; k < image::kVectorFloats; ++k) to[k] = from[k] / count;
    }
  }
  return true;
}

// Samples at center + axes * offset, averaged along `blur`; false if one is
// outside of the image.
template <int kSamples>
bool SampleSquare(const cv::Mat& image,
                  const Eigen::Vector2d& center,
                  const Eigen::Matrix2d& axes,
                  const Eigen::Vector2d& blur,
                  Square<kSamples>& square) {
  constexpr int kRadius = kSamples / 2;
  if (!HoldsSquare(image, kRadius, center, axes, blur)) return false;
  // Places are counted from a pixel near them, as numbers small enough for
  // their fractions to be exact.
  const Eigen::Vector2d reach =
      0.5 * blur.cwiseAbs() +
      axes.cwiseAbs() * Eigen::Vector2d(kRadius, kRadius);
  const Eigen::Vector2i origin = (center - reach).cwiseMax(0.0).cast<int>();
  const auto floats = [](const Eigen::Vector2d& point) {
    return std::array<float, 2>{static_cast<float>(point.x()),
                                static_cast<float>(point.y())};
  };
  SlantingSquare slanting;
  slanting.origin = image.ptr<unsigned char>(origin.y()) + origin.x();
  slanting.step = static_cast<std::ptrdiff_t>(image.step[0]);
  slanting.along = floats(axes.col(0));
  slanting.down = floats(axes.col(1));
  // A sample is between four pixels.
  slanting.last =
      floats(Eigen::Vector2d(image.cols - 1 - kBeforeLast - origin.x(),
                             image.rows - 1 - kBeforeLast - origin.y()));
  const Eigen::Vector2d top_left =
      center - origin.cast<double>() - axes * Eigen::Vector2d(kRadius, kRadius);
  const Taps taps = TapsAlong(blur);
  for (int tap = 0; tap < taps.count; ++tap) {
    slanting.first = floats(top_left + taps.first + tap * taps.step);
    GROUNDLOCK_WIDEST(AddSlantingSquare<Square<kSamples>>)(slanting, square);
  }
  const auto count = static_cast<float>(taps.count);
  for (int row = 0; row < kSamples; ++row) {
    float* samples = square.values.data() + row * Square<kSamples>::kPitch;
    for (int i = 0; i < Square<kSamples>::kPitch; ++i) {
      samples[i] = i < kSamples ? samples[i] / count : 0.0F;
    }
  }
  return true;
}

// What either image still has to be blurred by.
struct Equalizer {
  Eigen::Vector2d of_key;      // in the key image
  Eigen::Vector2d of_current;  // in the current one
};

std::optional<Equalizer> EqualizerFor(const PatchPair& pair) {
  if (!(std::abs(pair.key_from_current.determinant()) > 0.05) ||
      !(pair.key_blur.norm() < kMaxBlurPx) ||
      !(pair.current_blur.norm() < kMaxBlurPx)) {
    return std::nullopt;
  }
  Equalizer equalizer{pair.key_from_current * pair.current_blur,
                      pair.key_from_current.inverse() * pair.key_blur};
  // A blur has no sign.
  if (std::min((equalizer.of_current - pair.current_blur).norm(),
               (equalizer.of_current + pair.current_blur).norm()) <
      kSimilarBlurPx) {
    equalizer = {Eigen::Vector2d::Zero(), Eigen::Vector2d::Zero()};
  }
  return equalizer;
}

double Correlation(double product, double squares) {
  return squares > 0.0 ? product / std::sqrt(squares) : 0.0;
}

}  // namespace

std::optional<Eigen::Vector2d> AlignPatch(const cv::Mat& key,
                                          const cv::Mat& current,
                                          const PatchPair& pair,
                                          const Eigen::Vector2d& start) {
  const auto equalizer = EqualizerFor(pair);
  if (!equalizer) return std::nullopt;
  Square<kSide + 2> wide;  // by a pixel, for the derivatives
  Square<kRegion> region;
  if (!SampleSquare<kSide + 2>(key,
                               pair.key_point,
                               pair.key_from_current,
                               equalizer->of_key,
                               wide) ||
      !SampleSquare<kRegion>(current, start, equalizer->of_current, region)) {
    return std::nullopt;
  }
  // current(point + o) = gain * patch(o + d) + offset, linear in (gain d, gain,
  // offset).
  TakenPatch patch;
  GROUNDLOCK_WIDEST(TakePatch)(wide, patch);
  const auto& m = patch.moments;
  constexpr double kCount = kSide * kSide;
  Eigen::Matrix4d normal;
  normal << m[0], m[1], m[2], m[3],  //
      m[1], m[4], m[5], m[6],        //
      m[2], m[5], m[7], m[8],        //
      m[3], m[6], m[8], kCount;
  const Eigen::LDLT<Eigen::Matrix4d> solver(normal);
  if (solver.info() != Eigen::Success ||
      !(solver.vectorD().minCoeff() > 1e-3 * kSide)) {
    return std::nullopt;
  }
  const Eigen::Matrix4d inverse = solver.solve(Eigen::Matrix4d::Identity());
  Eigen::Vector2d moved = Eigen::Vector2d::Zero();  // from the start
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    if (!(moved.cwiseAbs().maxCoeff() < kReachPx - 0.01)) return std::nullopt;
    const int x = static_cast<int>(std::floor(moved.x()));
    const int y = static_cast<int>(std::floor(moved.y()));
    std::array<float, 5> seen;
    GROUNDLOCK_WIDEST(Compare)
    (region.values.data() + (kReachPx + y) * Square<kRegion>::kPitch +
         kReachPx + x,
     static_cast<float>(moved.x() - x),
     static_cast<float>(moved.y() - y),
     patch,
     seen);
    const Eigen::Vector4d solution =
        inverse * Eigen::Vector4d(seen[0], seen[1], seen[2], seen[3]);
    const double gain = solution[2];
    if (!(gain > 0.2 && gain < 5.0)) return std::nullopt;
    const Eigen::Vector2d step = solution.head<2>() / gain;
    if (!step.allFinite()) return std::nullopt;
    moved -= step;
    if (step.norm() < kEpsilonPx) {
      // The patch's own mean is zero.
      const double correlation =
          Correlation(seen[2], m[7] * (seen[4] - seen[3] * seen[3] / kCount));
      if (correlation < kMinCorrelation) return std::nullopt;
      return start + moved;
    }
  }
  return std::nullopt;
}

std::optional<double> PatchMismatch(const cv::Mat& key,
                                    const cv::Mat& current,
                                    const PatchPair& pair,
                                    const Eigen::Vector2d& point) {
  const auto equalizer = EqualizerFor(pair);
  Square<kSide> patch;
  Square<kSide> seen;
  if (!equalizer ||
      !SampleSquare<kSide>(key,
                           pair.key_point,
                           pair.key_from_current,
                           equalizer->of_key,
                           patch) ||
      !SampleSquare<kSide>(current, point, equalizer->of_current, seen)) {
    return std::nullopt;
  }
  using Rows = Eigen::Array<float, kSide, kSide, Eigen::RowMajor>;
  using Stride = Eigen::OuterStride<kPatchPitch>;
  const Eigen::Map<const Rows, 0, Stride> a(patch.values.data());
  const Eigen::Map<const Rows, 0, Stride> b(seen.values.data());
  const Rows da = a - a.mean();
  const Rows db = b - b.mean();
  const double correlation = std::max(
      0.0,
      Correlation((da * db).sum(),
                  static_cast<double>(da.square().sum()) * db.square().sum()));
  return 1.0 - correlation * correlation;
}

}  // namespace groundlock::localization
