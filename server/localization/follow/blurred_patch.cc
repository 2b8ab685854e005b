// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/blurred_patch.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace groundlock::localization {
namespace {

constexpr int kHalf = 6;
constexpr int kSide = 2 * kHalf + 1;
// How far from its start a patch is searched.
constexpr int kReachPx = 4;
constexpr int kMaxIterations = 10;
constexpr double kEpsilonPx = 0.01;
// Shorter blurs are no more than what the lens and the pixels do.
constexpr double kMinBlurPx = 0.7;
constexpr double kMaxBlurPx = 64.0;
constexpr double kTapSpacingPx = 1.25;
// Blurs that differ by less need no equalising, which costs detail.
constexpr double kSimilarBlurPx = 1.5;
constexpr double kMinCorrelation = 0.7;

template <int kSamples>
using Grid = Eigen::Matrix<float, kSamples, kSamples, Eigen::RowMajor>;

bool IsWithin(const cv::Mat& image, const Eigen::Vector2d& point) {
  return point.x() >= 0.0 && point.y() >= 0.0 && point.x() < image.cols - 1 &&
         point.y() < image.rows - 1;
}

// `point` is within the image.
float Sample(const cv::Mat& image, const Eigen::Vector2d& point) {
  const int x = static_cast<int>(point.x());
  const int y = static_cast<int>(point.y());
  const auto u = static_cast<float>(point.x() - x);
  const auto v = static_cast<float>(point.y() - y);
  const auto* above = image.ptr<unsigned char>(y) + x;
  const auto* below = image.ptr<unsigned char>(y + 1) + x;
  const float upper = static_cast<float>(above[0]) +
                      u * static_cast<float>(above[1] - above[0]);
  const float lower = static_cast<float>(below[0]) +
                      u * static_cast<float>(below[1] - below[0]);
  return upper + v * (lower - upper);
}

// Samples at center + axes * offset, averaged along `blur`; false if one is
// outside of the image.
template <int kSamples>
bool SampleGrid(const cv::Mat& image,
                const Eigen::Vector2d& center,
                const Eigen::Matrix2d& axes,
                const Eigen::Vector2d& blur,
                Grid<kSamples>& grid) {
  constexpr double kRadius = kSamples / 2;
  for (const double x : {-kRadius, kRadius}) {
    for (const double y : {-kRadius, kRadius}) {
      const Eigen::Vector2d corner = center + axes * Eigen::Vector2d(x, y);
      if (!IsWithin(image, corner - 0.5 * blur) ||
          !IsWithin(image, corner + 0.5 * blur)) {
        return false;
      }
    }
  }
  const double length_px = blur.norm();
  const int taps =
      length_px < kMinBlurPx
          ? 1
          : std::max(2, static_cast<int>(std::ceil(length_px / kTapSpacingPx)));
  const Eigen::Vector2d step = blur / taps;
  const Eigen::Vector2d first = center - 0.5 * (taps - 1) * step;
  for (int row = 0; row < kSamples; ++row) {
    for (int column = 0; column < kSamples; ++column) {
      Eigen::Vector2d point =
          first + axes * Eigen::Vector2d(column - kRadius, row - kRadius);
      float sum = 0.0F;
      for (int tap = 0; tap < taps; ++tap, point += step) {
        sum += Sample(image, point);
      }
      grid(row, column) = sum / static_cast<float>(taps);
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

double Correlation(const Grid<kSide>& a, const Grid<kSide>& b) {
  const Grid<kSide> da = a.array() - a.mean();
  const Grid<kSide> db = b.array() - b.mean();
  const double product =
      std::sqrt(static_cast<double>(da.squaredNorm()) * db.squaredNorm());
  return product > 0.0 ? da.cwiseProduct(db).sum() / product : 0.0;
}

}  // namespace

std::optional<Eigen::Vector2d> AlignPatch(const cv::Mat& key,
                                          const cv::Mat& current,
                                          const PatchPair& pair,
                                          const Eigen::Vector2d& start) {
  const auto equalizer = EqualizerFor(pair);
  if (!equalizer) return std::nullopt;
  Grid<kSide + 2> wide;  // by a pixel, for the derivatives
  constexpr int kRegion = kSide + 2 * kReachPx;
  Grid<kRegion> region;
  if (!SampleGrid<kSide + 2>(key,
                             pair.key_point,
                             pair.key_from_current,
                             equalizer->of_key,
                             wide) ||
      !SampleGrid<kRegion>(current,
                           start,
                           Eigen::Matrix2d::Identity(),
                           equalizer->of_current,
                           region)) {
    return std::nullopt;
  }
  const Grid<kSide> patch = wide.block<kSide, kSide>(1, 1);
  const Grid<kSide> dx =
      0.5F * (wide.block<kSide, kSide>(1, 2) - wide.block<kSide, kSide>(1, 0));
  const Grid<kSide> dy =
      0.5F * (wide.block<kSide, kSide>(2, 1) - wide.block<kSide, kSide>(0, 1));
  // current(point + o) = gain * patch(o + d) + offset, linear in (gain d, gain,
  // offset); the patch's mean is taken off for the sake of rounding.
  Eigen::Matrix<float, kSide * kSide, 4> A;
  A.col(0) = Eigen::Map<const Eigen::VectorXf>(dx.data(), dx.size());
  A.col(1) = Eigen::Map<const Eigen::VectorXf>(dy.data(), dy.size());
  A.col(2) =
      Eigen::Map<const Eigen::VectorXf>(patch.data(), patch.size()).array() -
      patch.mean();
  A.col(3).setOnes();
  const Eigen::Matrix4d normal = (A.transpose() * A).cast<double>();
  const Eigen::LDLT<Eigen::Matrix4d> solver(normal);
  if (solver.info() != Eigen::Success ||
      !(solver.vectorD().minCoeff() > 1e-3 * kSide)) {
    return std::nullopt;
  }
  Eigen::Vector2d moved = Eigen::Vector2d::Zero();  // from the start
  Grid<kSide> seen;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    if (!(moved.cwiseAbs().maxCoeff() < kReachPx - 0.01)) return std::nullopt;
    const int x = static_cast<int>(std::floor(moved.x()));
    const int y = static_cast<int>(std::floor(moved.y()));
    const auto u = static_cast<float>(moved.x() - x);
    const auto v = static_cast<float>(moved.y() - y);
    const int row = kReachPx + y;
    const int column = kReachPx + x;
    seen = (1.0F - v) * ((1.0F - u) * region.block<kSide, kSide>(row, column) +
                         u * region.block<kSide, kSide>(row, column + 1)) +
           v * ((1.0F - u) * region.block<kSide, kSide>(row + 1, column) +
                u * region.block<kSide, kSide>(row + 1, column + 1));
    const Eigen::Vector4d solution = solver.solve(
        (A.transpose() *
         Eigen::Map<const Eigen::Matrix<float, kSide * kSide, 1>>(seen.data()))
            .cast<double>());
    const double gain = solution[2];
    if (!(gain > 0.2 && gain < 5.0)) return std::nullopt;
    const Eigen::Vector2d step = solution.head<2>() / gain;
    if (!step.allFinite()) return std::nullopt;
    moved -= step;
    if (step.norm() < kEpsilonPx) {
      if (Correlation(patch, seen) < kMinCorrelation) return std::nullopt;
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
  Grid<kSide> patch;
  Grid<kSide> seen;
  if (!equalizer ||
      !SampleGrid<kSide>(key,
                         pair.key_point,
                         pair.key_from_current,
                         equalizer->of_key,
                         patch) ||
      !SampleGrid<kSide>(current,
                         point,
                         Eigen::Matrix2d::Identity(),
                         equalizer->of_current,
                         seen)) {
    return std::nullopt;
  }
  const double correlation = std::max(0.0, Correlation(patch, seen));
  return 1.0 - correlation * correlation;
}

}  // namespace groundlock::localization
